// Measured reflection: the two file families and what they share. All in double: half-vectors of
// grazing pairs and inverted tables lose too much in float.
#pragma once

#include <memory>
#include <optional>
#include <string_view>

#include "base/spectrum.h"
#include "base/vec.h"
#include "optics/tensor.h"

namespace matiere {

/// f cos_i [1/sr] and the density of `sample` [1/sr].
struct MeasuredValue {
    Spectrumd f;
    double pdf = 0.0;
};

class MeasuredData {
 public:
    virtual ~MeasuredData() = default;
    /// Both directions leave the surface and lie above it.
    virtual MeasuredValue eval(Vec3d wo, Vec3d wi) const = 0;
    virtual std::optional<Vec3d> sample(Vec3d wo, Vec3d u) const = 0;
    virtual bool is_anisotropic() const = 0;
};

/// What is wrong with the arrays of a file; empty if nothing is.
std::string_view measured_problem(const TensorSet& tensors);
/// From arrays without a problem. MERL has `merl` (3, 90, 90, 180); RGL `vndf`, `rgb`, ...
std::shared_ptr<const MeasuredData> make_measured(const TensorSet& tensors);

}  // namespace matiere
