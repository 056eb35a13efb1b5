// One parameter value from Python: number, colour, word, flag, ("texture", index), or the dict of
// another material: its "type" and its parameters; or ("data", {name: array}) for a file's arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <string>

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

/// A list of dicts: the parameters of its objects under "list/k/name", and its size.
inline bool is_list_of_dicts(const pybind11::handle& v) {
    namespace py = pybind11;
    if (!py::isinstance<py::list>(v)) return false;
    for (const auto& item : v.cast<py::list>())
        if (!py::isinstance<py::dict>(item)) return false;
    return true;
}

/// Absent and None mean the same: the parameter is not given.
inline std::map<std::string, ParamValue> param_values(const pybind11::dict& params) {
    namespace py = pybind11;
    std::map<std::string, ParamValue> values;
    for (const auto& [key, value] : params) {
        if (value.is_none()) continue;
        const auto name = key.cast<std::string>();
        if (!is_list_of_dicts(value)) {
            values[name] = param_value(value);
            continue;
        }
        int count = 0;
        for (const auto& item : value.cast<py::list>()) {
            const std::string prefix = name + "/" + std::to_string(count++) + "/";
            for (auto& [own, inner] : param_values(item.cast<py::dict>()))
                values[prefix + own] = inner;
        }
        values[name] = ListSize{count};
    }
    return values;
}

}  // namespace matiere
