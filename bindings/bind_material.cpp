// The parameter tables of all material models, as rows.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <set>

#include "material/model.h"
#include "material/schema.h"

namespace py = pybind11;

namespace matiere {
namespace {

py::object finite_or_none(double v) {
    return std::isfinite(v) ? py::object(py::float_(v)) : py::object(py::none());
}

py::object default_of(const ParamInfo& info) {
    if (!info.has_default) return py::none();
    switch (info.kind) {
        case ParamKind::kBool:
            return py::bool_(info.default_value != 0.0);
        case ParamKind::kList:
            return py::none();  // made from the rows of its objects
        case ParamKind::kEnum:
            return py::cast(info.choices[std::size_t(info.default_value)]);
        default:
            return py::float_(info.default_value);
    }
}

/// `default` is what may be filled in for an absent parameter. One of several alternatives has none
/// (filling it in would contradict the others); `implied` is its value where none is given.
py::dict row(const ParamInfo& info, bool alternative) {
    py::dict d;
    const bool number = info.kind == ParamKind::kScalar || info.kind == ParamKind::kColor;
    const bool ranged = number || info.kind == ParamKind::kList;
    d["name"] = info.name;
    d["kind"] = param_kind_name(info.kind);
    d["default"] = alternative ? py::object(py::none()) : default_of(info);
    d["implied"] = default_of(info);
    d["required"] = info.required;
    d["min"] = ranged ? finite_or_none(info.min) : py::object(py::none());
    d["max"] = ranged ? finite_or_none(info.max) : py::object(py::none());
    d["min_exclusive"] = info.min_exclusive;
    d["unit"] = info.unit;
    d["doc"] = info.doc;
    d["reason"] = info.reason;
    d["texture"] = number && !info.constant_only;
    d["constant_only"] = info.constant_only;
    if (info.choices.empty())
        d["choices"] = py::none();
    else
        d["choices"] = std::vector<std::string_view>(info.choices.begin(), info.choices.end());
    return d;
}

/// The row of a list: `items` are the rows of its objects; its default is as many of them as its
/// smallest number, each with their defaults.
py::dict list_row(const ParamInfo& list, const ModelSchema& schema) {
    const std::string prefix = std::string(list.name) + "/0/";
    py::list items, objects;
    py::dict filled;
    for (ParamInfo info : schema.params) {
        if (!info.name.starts_with(prefix)) continue;
        info.name.remove_prefix(prefix.size());
        items.append(row(info, false));
        filled[py::str(info.name)] = default_of(info);
    }
    for (int k = 0; k < int(list.default_value); ++k) objects.append(filled);
    py::dict d = row(list, false);
    d["items"] = items;
    d["default"] = objects;
    d["implied"] = objects;
    return d;
}

py::list names(const Rule& rule) {
    py::list list;
    for (std::size_t i = 0; i < rule.size(); ++i) list.append(rule.names[i]);
    return list;
}

py::dict features(std::uint32_t bits) {
    py::dict d;
    d["reflection"] = (bits & kFeatureReflection) != 0;
    d["transmission"] = (bits & kFeatureTransmission) != 0;
    d["interior"] = (bits & kFeatureInterior) != 0;
    d["anisotropic"] = (bits & kFeatureAnisotropic) != 0;
    d["delta"] = (bits & kFeatureDelta) != 0;
    d["reciprocal"] = (bits & kFeatureNotReciprocal) == 0;
    return d;
}

py::dict model(const ModelSchema& schema) {
    py::dict d;
    d["type"] = schema.type;
    d["doc"] = schema.doc;
    d["source"] = schema.source;
    d["features"] = features(schema.features);
    py::list exclusive, one_of, together, required;
    std::set<std::string_view> alternatives;
    for (const Rule& rule : schema.rules) switch (rule.kind) {
            case RuleKind::kExclusive:
                exclusive.append(names(rule));
                alternatives.insert(rule.names.begin(), rule.names.end());
                break;
            case RuleKind::kOneOf:
                one_of.append(names(rule));
                break;
            case RuleKind::kTogether:
                together.append(names(rule));
                break;
            case RuleKind::kRequires:
                required.append(names(rule));
                break;
        }
    py::list params;
    for (const ParamInfo& info : schema.params)
        if (info.kind == ParamKind::kList)
            params.append(list_row(info, schema));
        else if (info.name.find('/') == std::string_view::npos)
            params.append(row(info, alternatives.contains(info.name)));
    d["params"] = params;
    d["exclusive"] = exclusive;
    d["one_of"] = one_of;
    d["together"] = together;
    d["requires"] = required;
    return d;
}

py::list materials() {
    py::list list;
    for (const ModelSchema& schema : model_schemas()) list.append(model(schema));
    return list;
}

}  // namespace

void bind_material(py::module_& m) {
    m.def("materials", &materials,
          "Every material model with its parameter table and the rules that tie parameters.");
}

}  // namespace matiere
