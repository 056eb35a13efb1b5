// RGL's adaptively sampled measurements (Dupuy & Jakob 2018, "An Adaptive Parameterization for
// Efficient Material Acquisition and Rendering"). A half-vector is drawn by the visible normals of
// a retroreflection measurement (`vndf`), after a second warp by `luminance`; `rgb` holds what is
// left: f cos_i = rgb D(h) / (4 sigma(wo)). Isotropic where there are at most two azimuths.
// As published, values are conditioned on the viewer: not reciprocal to the last digit.
#pragma once

#include <array>
#include <vector>

#include "optics/measured.h"
#include "optics/warp2d.h"

namespace matiere {

class RglData : public MeasuredData {
 public:
    explicit RglData(const TensorSet& tensors);
    MeasuredValue eval(Vec3d wo, Vec3d wi) const override;
    std::optional<Vec3d> sample(Vec3d wo, Vec3d u) const override;
    bool is_anisotropic() const override { return !isotropic_; }

 private:
    /// Into the azimuths that were measured, by the material's own symmetry; signs of x and y.
    Vec2<double> symmetry(Vec3d wo) const;
    SliceBlend blend(double theta, double phi) const;

    bool isotropic_ = true;
    int reduction_ = 1;  // the measured azimuths are one part in `reduction` of the circle
    std::vector<double> theta_, phi_;
    Warp2D ndf_, sigma_, vndf_, luminance_;
    std::array<Warp2D, 3> rgb_;
};

}  // namespace matiere
