// One parameter value from Python: number, colour, word, flag, ("texture", index), or the dict of
// another material: its "type" and its parameters; or ("data", {name: array}) for a file's arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>

#include "material/description.h"

namespace matiere {

inline std::map<std::string, ParamValue> param_values(const pybind11::dict& params);

inline DataRef tensor_set(const pybind11::dict& arrays) {
    namespace py = pybind11;
    auto set = std::make_shared<TensorSet>();
    for (const auto& [key, value] : arrays) {
        const auto a = value.cast<py::array_t<float, py::array::c_style | py::array::forcecast>>();
        Tensor& t = (*set)[key.cast<std::string>()];
        for (py::ssize_t i = 0; i < a.ndim(); ++i) t.shape.push_back(std::size_t(a.shape(i)));
        t.values.assign(a.data(), a.data() + a.size());
    }
    return set;
}

inline ParamValue param_value(const pybind11::handle& v) {
    namespace py = pybind11;
    if (py::isinstance<py::dict>(v)) {
        auto nested = std::make_shared<MaterialDescription>();
        nested->params = param_values(v.cast<py::dict>());
        const auto type = nested->params.find("type");
        if (type != nested->params.end()) {
            if (const auto* word = std::get_if<std::string>(&type->second)) nested->type = *word;
            nested->params.erase(type);
        }
        return NestedDescription(nested);
    }
    if (py::isinstance<py::bool_>(v)) return v.cast<bool>();
    if (py::isinstance<py::str>(v)) return v.cast<std::string>();
    if (PyNumber_Check(v.ptr()) != 0 && PySequence_Check(v.ptr()) == 0) return v.cast<double>();
    if (py::isinstance<py::tuple>(v) && py::len(v) == 2) {
        const auto t = v.cast<py::tuple>();
        if (py::isinstance<py::str>(t[0]) && t[0].cast<std::string>() == "texture")
            return TextureRef{t[1].cast<int>()};
        if (py::isinstance<py::str>(t[0]) && t[0].cast<std::string>() == "data")
            return tensor_set(t[1].cast<py::dict>());
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
