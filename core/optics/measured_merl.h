// MERL's isotropic tables over half and difference angles (Matusik, Pfister, Brand, McMillan 2003,
// "A Data-Driven Reflectance Model"; Rusinkiewicz 1998 for the angles). 90 half angles, denser near
// 0 (theta_h = pi / 2 u^2), 90 difference angles, 180 azimuths of the difference with period pi:
// reciprocal as stored. Interpolated trilinearly between cell centres.
// Sampled by the half-vector: a cell of theta_h by its brightness, uniform within; mixed with a
// cosine lobe.
#pragma once

#include <array>
#include <vector>

#include "optics/measured.h"

namespace matiere {

class MerlData : public MeasuredData {
 public:
    static constexpr int kThetaH = 90, kThetaD = 90, kPhiD = 180;

    explicit MerlData(const Tensor& rgb);
    MeasuredValue eval(Vec3d wo, Vec3d wi) const override;
    std::optional<Vec3d> sample(Vec3d wo, Vec3d u) const override;
    bool is_anisotropic() const override { return false; }

 private:
    Spectrumd lookup(double theta_h, double theta_d, double phi_d) const;
    Spectrumd cell(int h, int d, int p) const;
    double pdf(Vec3d wo, Vec3d wi, Vec3d h) const;

    std::vector<float> values_;                    // [h][d][p][channel]
    std::array<double, kThetaH + 1> cumulated_{};  // probability of the cells of theta_h
    std::array<double, kThetaH + 1> edges_{};      // 1 - cos(theta_h) at their edges
};

}  // namespace matiere
