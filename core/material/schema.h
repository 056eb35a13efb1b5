// The parameter tables of all models as rows, for bindings, docs and generated validation.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "material/param.h"

namespace matiere {

struct ModelSchema {
    std::string_view type, doc, source;
    std::uint32_t features = 0;  ///< ModelFeature bits
    std::vector<ParamInfo> params;
    std::vector<Rule> rules;
};

/// One entry per model, in the order of the list.
std::vector<ModelSchema> model_schemas();

/// All model names, comma-separated.
std::string model_names();

std::string_view param_kind_name(ParamKind kind);

}  // namespace matiere
