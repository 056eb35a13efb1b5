#include "light/environment.h"

#include <array>
#include <cmath>

namespace matiere {

EnvironmentLight::EnvironmentLight(int width, int height, std::vector<float> pixels,
                                   double rotation_deg, double scale, Portals portals)
    : width_(width), height_(height), pixels_(std::move(pixels)), portals_(std::move(portals)) {
    const double angle = rotation_deg * kPi<double> / 180;
    cos_rotation_ = float(std::cos(angle));
    sin_rotation_ = float(std::sin(angle));
    for (float& p : pixels_) p = float(double(p) * scale);
    build_distribution();
}

std::size_t EnvironmentLight::bytes() const {
    return pixels_.size() * sizeof(float) + map_.bytes();
}

Spectrumf EnvironmentLight::pixel(int x, int y) const {
    const float* p = &pixels_[(std::size_t(y) * std::size_t(width_) + std::size_t(x)) * 3];
    return {p[0], p[1], p[2]};
}

/// Luminance of the bilinear map averaged over each pixel's rectangle of the sphere: 1/8, 6/8, 1/8
/// along each axis.
std::vector<double> EnvironmentLight::cell_means() const {
    const auto w = std::size_t(width_), h = std::size_t(height_);
    std::vector<double> luminance(w * h), across(w * h), cells(w * h);
    for (std::size_t i = 0; i < w * h; ++i)
        luminance[i] =
            double(Spectrumf(pixels_[3 * i], pixels_[3 * i + 1], pixels_[3 * i + 2]).luminance());
    for (std::size_t y = 0; y < h; ++y)
        for (std::size_t x = 0; x < w; ++x)
            across[y * w + x] =
                0.75 * luminance[y * w + x] +
                0.125 * (luminance[y * w + (x + 1) % w] + luminance[y * w + (x + w - 1) % w]);
    for (std::size_t y = 0; y < h; ++y) {
        const std::size_t above = y == 0 ? y : y - 1, below = y + 1 == h ? y : y + 1;
        for (std::size_t x = 0; x < w; ++x)
            cells[y * w + x] =
                0.75 * across[y * w + x] + 0.125 * (across[above * w + x] + across[below * w + x]);
    }
    return cells;
}

/// What exceeds the mean, over which light sampling is worth its ray: the even rest is found better
/// by the materials' own directions (MIS compensation: Karlik, Sik, Vevoda, Skrivan, Krivanek
/// 2019). Directions of density zero count in full where a material samples them.
void EnvironmentLight::build_distribution() {
    constexpr double kFlat = 1e-6;  // above the rounding of the mean itself
    const auto w = std::size_t(width_), h = std::size_t(height_);
    cos_edge_.resize(h + 1);
    for (std::size_t y = 0; y <= h; ++y)
        cos_edge_[y] = std::cos(kPi<double> * double(y) / double(h));
    const auto solid_angle = [&](std::size_t y) {
        return (cos_edge_[y] - cos_edge_[y + 1]) * 2 * kPi<double> / double(w);
    };

    std::vector<double> cells = cell_means();
    double mean = 0;
    for (std::size_t i = 0; i < w * h; ++i) mean += cells[i] * solid_angle(i / w);
    mean /= 4 * kPi<double>;
    mean_luminance_ = mean;

    double total = 0;
    for (std::size_t i = 0; i < w * h; ++i) {
        double& c = cells[i];
        c = c > mean * (1 + kFlat) ? (c - mean) * solid_angle(i / w) : 0.0;
        total += c;
    }
    map_ = MapSampler(width_, height_, cells);
    sampled_luminance_ = total / (4 * kPi<double>);
}

EnvironmentLight::Texel EnvironmentLight::to_texel(Vec3f d) const {
    // Undo the rotation about +y, then read the angles without acos: exact near the poles.
    const float x = cos_rotation_ * d.x - sin_rotation_ * d.z;
    const float z = sin_rotation_ * d.x + cos_rotation_ * d.z;
    const float phi = std::atan2(x, -z);
    const float theta = std::atan2(std::sqrt(x * x + z * z), d.y);
    const float u = (phi * (0.5F * kInvPi<float>)+0.5F) * float(width_);
    return {u < float(width_) ? std::max(u, 0.0F) : 0.0F,
            std::min(theta * kInvPi<float> * float(height_), float(height_))};
}

Vec3f EnvironmentLight::from_angles(float sin_theta, float cos_theta, float phi) const {
    const float x = sin_theta * std::sin(phi), z = -sin_theta * std::cos(phi);
    return {cos_rotation_ * x + sin_rotation_ * z, cos_theta,
            -sin_rotation_ * x + cos_rotation_ * z};
}

Spectrumf EnvironmentLight::lookup(Texel t) const {
    const float u = t.u - 0.5F, v = std::clamp(t.v - 0.5F, 0.0F, float(height_ - 1));
    const float fu = std::floor(u), fv = std::floor(v);
    const int x0 = (int(fu) + width_) % width_, x1 = (x0 + 1) % width_;
    const int y0 = int(fv), y1 = std::min(y0 + 1, height_ - 1);
    const float a = u - fu, b = v - fv;
    return (1 - b) * ((1 - a) * pixel(x0, y0) + a * pixel(x1, y0)) +
           b * ((1 - a) * pixel(x0, y1) + a * pixel(x1, y1));
}

Spectrumf EnvironmentLight::radiance(Vec3f direction) const {
    return is_constant() ? pixel(0, 0) : lookup(to_texel(direction));
}

float EnvironmentLight::portal_share(Vec3f reference) const {
    if (portals_.empty() || portals_.faced(reference) == 0) return 0;
    return map_.empty() ? 1.0F : 0.5F;
}

double EnvironmentLight::sampled_power(double disk) const {
    return portals_.empty() ? 4 * kPi<double> * disk * sampled_luminance_
                            : portals_.area() * mean_luminance_;
}

float EnvironmentLight::pdf(const Receiver& at, Vec3f direction) const {
    const float share = portal_share(at.p);
    if (share == 0) return map_pdf(at, direction);
    const float through = portals_.pdf(at.p, direction);
    if (!(through > 0)) return 0;
    return share < 1 ? share * through + (1 - share) * map_pdf(at, direction) : through;
}

EnvironmentLight::Seen EnvironmentLight::see(const Receiver& at, Vec3f direction) const {
    if (is_constant() || !portals_.empty()) return {radiance(direction), pdf(at, direction)};
    const Texel t = to_texel(direction);
    return {lookup(t), map_.empty() ? 0 : map_pdf(table(at), t)};
}

/// One-sample MIS of portals and map (Veach 1997, 9.2.4), of directions through portals alone.
std::optional<EnvironmentLight::Sample> EnvironmentLight::sample(const Receiver& at,
                                                                 const SampleBlock& u) const {
    const float share = portal_share(at.p), x = u.uniform(3);
    if (share == 0) return sample_map(at, u);
    Sample s;
    if (x < share) {
        const auto through = portals_.sample(at.p, x / share, u);
        if (!through) return std::nullopt;
        s.wi = through->wi;
    } else {
        const auto found = sample_map(at, u);
        if (!found) return std::nullopt;
        s.wi = found->wi;
    }
    s.radiance = radiance(s.wi);
    s.pdf = pdf(at, s.wi);
    return s;
}

int EnvironmentLight::table(const Receiver& at) const {
    return MapSampler::table({cos_rotation_ * at.n.x - sin_rotation_ * at.n.z, at.n.y,
                              sin_rotation_ * at.n.x + cos_rotation_ * at.n.z});
}

float EnvironmentLight::map_pdf(int table, Texel t) const {
    const auto x = std::size_t(std::min(int(t.u), width_ - 1)),
               y = std::size_t(std::min(int(t.v), height_ - 1));
    const double solid_angle = (cos_edge_[y] - cos_edge_[y + 1]) * 2 * kPi<double> / double(width_);
    return float(double(map_.probability(table, x, y)) / solid_angle);
}

std::optional<EnvironmentLight::Sample> EnvironmentLight::sample_map(const Receiver& at,
                                                                     const SampleBlock& u) const {
    if (map_.empty()) return std::nullopt;
    const auto pick = map_.sample(table(at), u.bits[2], u.bits[1]);
    if (!(pick.probability > 0)) return std::nullopt;

    // Uniform in solid angle inside the texel: in cos(theta) and in phi.
    const double c0 = cos_edge_[pick.y], c1 = cos_edge_[pick.y + 1];
    const double c = c0 + double(pick.v) * (c1 - c0);
    const auto cos_theta = float(c);
    // sin from theta's distance to the nearer pole, not from 1 - cos^2.
    const double one_minus = 1 - std::abs(c);
    const auto sin_theta = float(std::sqrt(std::max(0.0, one_minus * (2 - one_minus))));
    const float u_texel = float(pick.x) + pick.u;
    const Vec3f wi =
        from_angles(sin_theta, cos_theta, kTwoPi<float> * (u_texel / float(width_) - 0.5F));
    const float theta = std::atan2(sin_theta, cos_theta);
    const Texel t{u_texel, theta * kInvPi<float> * float(height_)};
    const double solid_angle = (c0 - c1) * 2 * kPi<double> / double(width_);
    return Sample{wi, lookup(t), float(double(pick.probability) / solid_angle)};
}

}  // namespace matiere
