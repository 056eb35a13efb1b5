#include "optics/measured.h"

#include <algorithm>
#include <cmath>

#include "optics/measured_merl.h"
#include "optics/measured_rgl.h"

namespace matiere {
namespace {

bool increases(const Tensor& t) {
    for (std::size_t i = 0; i < t.values.size(); ++i)
        if (!std::isfinite(t.values[i]) || (i > 0 && !(t.values[i] > t.values[i - 1])))
            return false;
    return true;
}

bool is_grid(const Tensor& t, std::size_t slices_1, std::size_t slices_2) {
    const std::size_t n = t.shape.size();
    if (n < 4 || t.shape[0] != slices_1 || t.shape[1] != slices_2) return false;
    return t.shape[n - 2] >= 2 && t.shape[n - 1] >= 2 && t.has_shape(t.shape);
}

bool is_table(const Tensor& t) {
    return t.shape.size() == 2 && t.shape[0] >= 2 && t.shape[1] >= 2 && t.has_shape(t.shape);
}

/// Real files hold roundings below zero.
bool is_density(const Tensor& t) {
    constexpr float kRounding = 1e-6F;
    float low = 0, high = 0;
    for (const float v : t.values) {
        if (!std::isfinite(v)) return false;
        low = std::min(low, v);
        high = std::max(high, v);
    }
    return high > 0 && low >= -kRounding * high;
}

std::string_view rgl_problem(const TensorSet& all) {
    for (const char* name : {"theta_i", "phi_i", "ndf", "sigma", "vndf", "luminance", "rgb"})
        if (!all.contains(name)) return "the file lacks one of RGL's fields";
    const Tensor &theta = all.at("theta_i"), &phi = all.at("phi_i");
    if (theta.values.size() < 2 || !increases(theta) || phi.values.empty() || !increases(phi))
        return "theta_i and phi_i must increase";
    const std::size_t np = phi.values.size(), nt = theta.values.size();
    if (!is_grid(all.at("vndf"), np, nt) || !is_grid(all.at("luminance"), np, nt) ||
        all.at("vndf").shape.size() != 4 || all.at("luminance").shape.size() != 4)
        return "vndf or luminance has a wrong shape";
    const Tensor& rgb = all.at("rgb");
    if (!is_grid(rgb, np, nt) || rgb.shape.size() != 5 || rgb.shape[2] != 3)
        return "rgb has a wrong shape";
    if (!is_table(all.at("ndf")) || !is_table(all.at("sigma")))
        return "ndf or sigma has a wrong shape";
    if (np > 2) {
        const double turns = 6.283185307179586 / double(phi.values.back() - phi.values.front());
        const long part = std::lround(turns);
        if ((part != 1 && part != 2 && part != 4) || std::abs(turns - double(part)) > 0.02)
            return "phi_i must cover the circle, its half or its quarter";
    }
    for (const char* name : {"ndf", "sigma", "vndf", "luminance"})
        if (!is_density(all.at(name))) return "a density is negative, zero or not finite";
    for (const float v : rgb.values)
        if (!std::isfinite(v)) return "a value is not finite";
    return {};
}

}  // namespace

std::string_view measured_problem(const TensorSet& tensors) {
    const auto merl = tensors.find("merl");
    if (merl == tensors.end()) return rgl_problem(tensors);
    if (!merl->second.has_shape({3, MerlData::kThetaH, MerlData::kThetaD, MerlData::kPhiD}))
        return "a MERL table has 3 x 90 x 90 x 180 values";
    for (const float v : merl->second.values)
        if (!std::isfinite(v)) return "a value is not finite";
    return {};
}

std::shared_ptr<const MeasuredData> make_measured(const TensorSet& tensors) {
    const auto merl = tensors.find("merl");
    if (merl != tensors.end()) return std::make_shared<MerlData>(merl->second);
    return std::make_shared<RglData>(tensors);
}

}  // namespace matiere
