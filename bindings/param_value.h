// One parameter value from Python: number, colour, word, flag, or ("texture", index).
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>

#include "material/description.h"

namespace matiere {

inline ParamValue param_value(const pybind11::handle& v) {
    namespace py = pybind11;
    if (py::isinstance<py::bool_>(v)) return v.cast<bool>();
    if (py::isinstance<py::str>(v)) return v.cast<std::string>();
    if (PyNumber_Check(v.ptr()) != 0 && PySequence_Check(v.ptr()) == 0) return v.cast<double>();
    if (py::isinstance<py::tuple>(v) && py::len(v) == 2) {
        const auto t = v.cast<py::tuple>();
        if (py::isinstance<py::str>(t[0]) && t[0].cast<std::string>() == "texture")
            return TextureRef{t[1].cast<int>()};
    }
    return v.cast<std::array<double, 3>>();
}

/// Absent and None mean the same: the parameter is not given.
inline std::map<std::string, ParamValue> param_values(const pybind11::dict& params) {
    std::map<std::string, ParamValue> values;
    for (const auto& [key, value] : params)
        if (!value.is_none()) values[key.cast<std::string>()] = param_value(value);
    return values;
}

}  // namespace matiere
