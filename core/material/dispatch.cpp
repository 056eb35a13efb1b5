// The calls that may reach any model, in float: one place for the code of them all.
#include "material/record.h"

namespace matiere {

template BsdfEval<float> eval_model<float>(const AnyModel<float>&, Vec3<float>, Vec3<float>);
template std::optional<BsdfSample<float>> sample_model<float>(const AnyModel<float>&, Vec3<float>,
                                                              Vec3<float>);
template std::uint8_t model_lobes<float>(const AnyModel<float>&);

}  // namespace matiere
