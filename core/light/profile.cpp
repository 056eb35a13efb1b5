#include "light/profile.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/numeric.h"

namespace matiere {

namespace {

constexpr float kDegrees = 180 * kInvPi<float>;

struct Place {
    std::size_t low, high;
    float share;  ///< of `high`
};

Place find(const std::vector<float>& angles, float x) {
    if (angles.size() == 1) return {0, 0, 0};
    const auto above = std::upper_bound(angles.begin(), angles.end(), x);
    const auto high =
        std::clamp<std::ptrdiff_t>(above - angles.begin(), 1, std::ptrdiff_t(angles.size()) - 1);
    const auto i = std::size_t(high);
    const float a = angles[i - 1], b = angles[i];
    return {i - 1, i, std::clamp((x - a) / (b - a), 0.0F, 1.0F)};
}

}  // namespace

LightProfile::LightProfile(std::vector<float> vertical_deg, std::vector<float> horizontal_deg,
                           std::vector<float> values)
    : vertical_(std::move(vertical_deg)),
      horizontal_(std::move(horizontal_deg)),
      values_(std::move(values)) {}

float LightProfile::value(float vertical, float horizontal) const {
    if (vertical < vertical_.front() || vertical > vertical_.back()) return 0;
    const Place v = find(vertical_, vertical), h = find(horizontal_, horizontal);
    const auto row = [&](std::size_t i) {
        const float* r = &values_[i * vertical_.size()];
        return lerp(v.share, r[v.low], r[v.high]);
    };
    return lerp(h.share, row(h.low), row(h.high));
}

double LightProfile::flux(double cos_outer) const {
    constexpr int kVertical = 720, kHorizontal = 90;
    double sum = 0;
    for (int i = 0; i < kVertical; ++i) {
        const double theta = kPi<double> * (i + 0.5) / kVertical;
        if (std::cos(theta) < cos_outer) break;
        double ring = 0;
        for (int k = 0; k < kHorizontal; ++k)
            ring += double(
                value(float(180 * (i + 0.5) / kVertical), float(360 * (k + 0.5) / kHorizontal)));
        sum += ring * std::sin(theta);
    }
    return sum * kPi<double> / kVertical * 2 * kPi<double> / kHorizontal;
}

ProfileFrame ProfileFrame::hung(Vec3f axis, double rotation_deg) {
    const Vec3d down{0, -1, 0}, to = normalize(vec_cast<double>(axis));
    const Vec3d v = cross(down, to);
    const double c = dot(down, to);
    // Straight up there is no shortest way: about the x axis.
    const auto turned = [&](Vec3d a) {
        if (c < -1 + 1e-12) return Vec3d{a.x, -a.y, -a.z};
        return a + cross(v, a) + cross(v, cross(v, a)) * (1 / (1 + c));
    };
    const Vec3d zero = turned({1, 0, 0}), quarter = turned({0, 0, -1});
    const double angle = rotation_deg * kPi<double> / 180;
    const double cosine = std::cos(angle), sine = std::sin(angle);
    return {vec_cast<float>(to), vec_cast<float>(zero * cosine + quarter * sine),
            vec_cast<float>(quarter * cosine - zero * sine)};
}

float ProfileFrame::value(const LightProfile& profile, Vec3f away) const {
    const float x = dot(away, zero), y = dot(away, quarter);
    const float vertical = std::atan2(std::sqrt(x * x + y * y), dot(away, axis)) * kDegrees;
    const float phi = std::atan2(y, x) * kDegrees;
    return profile.value(std::min(vertical, 180.0F), phi < 0 ? phi + 360 : phi);
}

}  // namespace matiere
