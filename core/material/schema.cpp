#include "material/schema.h"

#include "material/models.h"

namespace matiere {

std::vector<ModelSchema> model_schemas() {
    std::vector<ModelSchema> schemas;
    for_each_model<float>([&]<class M>(std::type_identity<M>) {
        ModelSchema s{M::kName, M::kDoc, M::kSource, M::kFeatures, {}, {}};
        for (const auto& row : M::Params::table()) s.params.push_back(row.info);
        for (const Rule& rule : M::Params::rules()) s.rules.push_back(rule);
        schemas.push_back(std::move(s));
    });
    return schemas;
}

std::string model_names() {
    std::string names;
    for_each_model<float>([&]<class M>(std::type_identity<M>) {
        names += (names.empty() ? "" : ", ") + std::string(M::kName);
    });
    return names;
}

std::string_view param_kind_name(ParamKind kind) {
    switch (kind) {
        case ParamKind::kScalar:
            return "scalar";
        case ParamKind::kColor:
            return "color";
        case ParamKind::kBool:
            return "bool";
        case ParamKind::kEnum:
            return "enum";
        case ParamKind::kMetal:
            return "metal";
        case ParamKind::kMaterial:
            return "material";
        case ParamKind::kList:
            return "list";
        case ParamKind::kFile:
            return "file";
    }
    return "";
}

}  // namespace matiere
