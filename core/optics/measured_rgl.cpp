#include "optics/measured_rgl.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace matiere {
namespace {

/// Half-vectors this near to the normal share one density (as the format's own loader has it).
constexpr double kMinJacobian = 1e-6;

double u_of_theta(double theta) { return std::sqrt(theta * 2.0 * kInvPi<double>); }
double theta_of_u(double u) { return u * u * (kPi<double> / 2.0); }
double u_of_phi(double phi) { return (phi + kPi<double>) / kTwoPi<double>; }

double theta_of(Vec3d w) { return std::atan2(std::sqrt(w.x * w.x + w.y * w.y), w.z); }
double phi_of(Vec3d w) { return std::atan2(w.y, w.x); }

/// Solid angle of h per area of the unit square, times that of the reflection.
double jacobian(double u_theta, double theta, double oh) {
    return std::max(2.0 * sqr(kPi<double>) * u_theta * std::sin(theta), kMinJacobian) * 4.0 * oh;
}

struct Place {
    int low = 0;
    double part = 0.0;
};

Place place(const std::vector<double>& nodes, double x) {
    if (nodes.size() < 2) return {};
    const auto next = std::upper_bound(nodes.begin() + 1, nodes.end() - 1, x);
    const int i = int(next - nodes.begin()) - 1;
    const double a = nodes[std::size_t(i)], b = nodes[std::size_t(i) + 1];
    return {i, std::clamp((x - a) / (b - a), 0.0, 1.0)};
}

Warp2D warp(const Tensor& t, bool normalized) {
    const std::size_t n = t.shape.size();
    int slices = 1;
    for (std::size_t i = 0; i + 2 < n; ++i) slices *= int(t.shape[i]);
    return {t.values.data(), slices, int(t.shape[n - 2]), int(t.shape[n - 1]), normalized};
}

}  // namespace

RglData::RglData(const TensorSet& tensors) {
    const auto nodes = [&](const char* name) {
        const auto& v = tensors.at(name).values;
        return std::vector<double>(v.begin(), v.end());
    };
    theta_ = nodes("theta_i");
    phi_ = nodes("phi_i");
    isotropic_ = phi_.size() <= 2;
    if (isotropic_)
        phi_.resize(1);
    else
        reduction_ = int(std::lround(kTwoPi<double> / (phi_.back() - phi_.front())));
    ndf_ = warp(tensors.at("ndf"), false);
    sigma_ = warp(tensors.at("sigma"), false);
    vndf_ = warp(tensors.at("vndf"), true);
    luminance_ = warp(tensors.at("luminance"), true);
    const Tensor& rgb = tensors.at("rgb");  // [phi][theta][channel][h][w]
    const std::size_t size = rgb.shape[3] * rgb.shape[4];
    for (std::size_t c = 0; c < 3; ++c) {
        Tensor one{{rgb.shape[0], rgb.shape[1], rgb.shape[3], rgb.shape[4]}, {}};
        for (std::size_t s = 0; s < rgb.shape[0] * rgb.shape[1]; ++s) {
            const auto first = rgb.values.begin() + std::ptrdiff_t((s * 3 + c) * size);
            one.values.insert(one.values.end(), first, first + std::ptrdiff_t(size));
        }
        rgb_[c] = warp(one, false);
    }
}

Vec2<double> RglData::symmetry(Vec3d wo) const {
    if (reduction_ < 2) return {1.0, 1.0};
    const double y = wo.y > 0.0 ? -1.0 : 1.0;
    if (reduction_ < 4) return {y, y};
    return {wo.x > 0.0 ? -1.0 : 1.0, y};
}

SliceBlend RglData::blend(double theta, double phi) const {
    const Place t = place(theta_, theta), p = place(phi_, phi);
    const int count = int(theta_.size());
    SliceBlend b;
    for (int k = 0; k < 4; ++k) {
        const int dt = k & 1, dp = k >> 1;
        const double share = (dt ? t.part : 1.0 - t.part) * (dp ? p.part : 1.0 - p.part);
        b.share[std::size_t(k)] = share;
        b.slice[std::size_t(k)] = share > 0.0 ? (p.low + dp) * count + t.low + dt : 0;
    }
    return b;
}

MeasuredValue RglData::eval(Vec3d wo, Vec3d wi) const {
    const Vec2<double> turn = symmetry(wo);
    const Vec3d o{wo.x * turn.x, wo.y * turn.y, wo.z};
    const Vec3d i{wi.x * turn.x, wi.y * turn.y, wi.z};
    const Vec3d h = normalize(o + i);
    const double theta_o = theta_of(o), phi_o = phi_of(o), theta_h = theta_of(h);
    const double phi_h = isotropic_ ? phi_of(h) - phi_o : phi_of(h);
    Vec2<double> at{u_of_theta(theta_h), u_of_phi(phi_h)};
    at.y -= std::floor(at.y);

    const SliceBlend slices = blend(theta_o, phi_o);
    const Warp2D::Result visible = vndf_.invert(at, slices);
    const SliceBlend only{{0, 0, 0, 0}, {1.0, 0.0, 0.0, 0.0}};
    const double sigma = sigma_.eval({u_of_theta(theta_o), u_of_phi(phi_o)}, only);
    const double scale = ndf_.eval(at, only) / (4.0 * sigma);
    Spectrumd f;
    for (int c = 0; c < 3; ++c) f[c] = rgb_[std::size_t(c)].eval(visible.at, slices) * scale;
    const double pdf =
        visible.pdf * luminance_.eval(visible.at, slices) / jacobian(at.x, theta_h, dot(o, h));
    if (!(sigma > 0.0)) return {};
    return {f, pdf};
}

std::optional<Vec3d> RglData::sample(Vec3d wo, Vec3d u) const {
    const Vec2<double> turn = symmetry(wo);
    const Vec3d o{wo.x * turn.x, wo.y * turn.y, wo.z};
    const double phi_o = phi_of(o);
    const SliceBlend slices = blend(theta_of(o), phi_o);
    const Vec2<double> s = luminance_.sample({u.z, u.y}, slices).at;
    const Vec2<double> at = vndf_.sample(s, slices).at;
    const double theta = theta_of_u(at.x);
    double phi = (2.0 * at.y - 1.0) * kPi<double>;
    if (isotropic_) phi += phi_o;
    const double sin_h = std::sin(theta);
    const Vec3d h{sin_h * std::cos(phi), sin_h * std::sin(phi), std::cos(theta)};
    const double oh = dot(o, h);
    if (!(oh > 0.0)) return {};
    const Vec3d i = h * (2.0 * oh) - o;
    return Vec3d{i.x * turn.x, i.y * turn.y, i.z};
}

}  // namespace matiere
