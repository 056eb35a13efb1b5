#include "optics/measured_merl.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"
#include "sampling/warp.h"

namespace matiere {
namespace {

/// Share of samples from the cosine lobe: what the cells of theta_h miss stays bounded.
constexpr double kCosineShare = 0.1;

double theta_h_at(double cell) { return 0.5 * kPi<double> * sqr(cell / MerlData::kThetaH); }

/// Between two neighbouring centres along one axis, held at the ends.
struct Between {
    int low, high;
    double part;
    Between(double x, int n) {
        x = std::clamp(x - 0.5, 0.0, double(n - 1));
        low = std::min(int(x), n - 2);
        high = low + 1;
        part = x - low;
    }
};

}  // namespace

MerlData::MerlData(const Tensor& rgb) {
    constexpr std::size_t kCells = std::size_t(kThetaH) * kThetaD * kPhiD;
    values_.resize(kCells * 3);
    for (std::size_t i = 0; i < kCells; ++i)
        for (std::size_t c = 0; c < 3; ++c)
            // A negative cell was not measured or lies below the horizon.
            values_[i * 3 + c] = std::max(rgb.values[c * kCells + i], 0.0F);

    std::array<double, kThetaH> mass{};
    double sum = 0.0;
    for (int h = 0; h < kThetaH; ++h) {
        edges_[std::size_t(h) + 1] = 2.0 * sqr(std::sin(0.5 * theta_h_at(h + 1)));
        Spectrumd bright;
        for (int d = 0; d < kThetaD * 2 / 3; ++d)
            for (int p = 0; p < kPhiD; p += 4) bright += cell(h, d, p);
        const double size = edges_[std::size_t(h) + 1] - edges_[std::size_t(h)];
        mass[std::size_t(h)] = bright.average() * size * std::cos(theta_h_at(h + 0.5));
        sum += mass[std::size_t(h)];
    }
    for (std::size_t h = 0; h < kThetaH; ++h)
        cumulated_[h + 1] = cumulated_[h] + (sum > 0.0 ? mass[h] / sum : 1.0 / kThetaH);
    cumulated_[kThetaH] = 1.0;
}

Spectrumd MerlData::cell(int h, int d, int p) const {
    const float* v =
        &values_[3 * (std::size_t(p) + kPhiD * (std::size_t(d) + kThetaD * std::size_t(h)))];
    return {double(v[0]), double(v[1]), double(v[2])};
}

Spectrumd MerlData::lookup(double theta_h, double theta_d, double phi_d) const {
    const Between h(kThetaH * std::sqrt(theta_h * 2.0 * kInvPi<double>), kThetaH);
    const Between d(kThetaD * theta_d * 2.0 * kInvPi<double>, kThetaD);
    if (phi_d < 0.0) phi_d += kPi<double>;
    const double p = kPhiD * phi_d * kInvPi<double> - 0.5;
    const double low = std::floor(p);
    const int p0 = (int(low) + kPhiD) % kPhiD, p1 = (p0 + 1) % kPhiD;
    const auto line = [&](int i, int j) {
        return cell(i, j, p0) * (1.0 - (p - low)) + cell(i, j, p1) * (p - low);
    };
    const auto plane = [&](int i) {
        return line(i, d.low) * (1.0 - d.part) + line(i, d.high) * d.part;
    };
    return plane(h.low) * (1.0 - h.part) + plane(h.high) * h.part;
}

double MerlData::pdf(Vec3d wo, Vec3d wi, Vec3d h) const {
    const double s = (h.x * h.x + h.y * h.y) / (1.0 + h.z);  // 1 - cos, without cancellation
    const auto next = std::upper_bound(edges_.begin() + 1, edges_.end() - 1, s);
    const auto k = std::size_t(next - edges_.begin()) - 1;
    const double density =
        (cumulated_[k + 1] - cumulated_[k]) / (kTwoPi<double> * (edges_[k + 1] - edges_[k]));
    return kCosineShare * cosine_hemisphere_pdf(wi.z) +
           (1.0 - kCosineShare) * density / (4.0 * dot(wo, h));
}

MeasuredValue MerlData::eval(Vec3d wo, Vec3d wi) const {
    const Vec3d h = normalize(wo + wi);
    const double sin_h = std::sqrt(h.x * h.x + h.y * h.y);
    const Vec2<double> phi =
        sin_h > 0.0 ? Vec2<double>{h.x / sin_h, h.y / sin_h} : Vec2<double>{1.0, 0.0};
    // The light's direction with h turned to the pole: its angles are those of the difference.
    const double x = h.z * (wi.x * phi.x + wi.y * phi.y) - sin_h * wi.z;
    const double y = wi.y * phi.x - wi.x * phi.y;
    const double theta_d = std::atan2(std::sqrt(x * x + y * y), dot(wi, h));
    const Spectrumd f = lookup(std::atan2(sin_h, h.z), theta_d, std::atan2(y, x));
    return {f * wi.z, pdf(wo, wi, h)};
}

std::optional<Vec3d> MerlData::sample(Vec3d wo, Vec3d u) const {
    if (u.x < kCosineShare) return square_to_cosine_hemisphere(u.y, u.z);
    const double v = (u.x - kCosineShare) / (1.0 - kCosineShare);
    const auto next = std::upper_bound(cumulated_.begin() + 1, cumulated_.end() - 1, v);
    const auto k = std::size_t(next - cumulated_.begin()) - 1;
    const double s = std::lerp(edges_[k], edges_[k + 1], u.y);
    const double sin_h = std::sqrt(s * (2.0 - s)), turn = kTwoPi<double> * u.z;
    const Vec3d h{sin_h * std::cos(turn), sin_h * std::sin(turn), 1.0 - s};
    const double oh = dot(wo, h);
    if (!(oh > 0.0)) return {};
    return h * (2.0 * oh) - wo;
}

}  // namespace matiere
