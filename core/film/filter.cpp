#include "film/filter.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "base/error.h"
#include "base/numeric.h"

namespace matiere {
namespace {

constexpr int kCells = 256;  // of the half width: the inverse is linear inside one cell
constexpr int kBins = 64;    // of the variate: where to look for its cell
constexpr int kSimpson = 8;  // even steps per cell, error far below float rounding

/// Unnormalised filter value at t = |x| / radius in [0, 1].
double shape(FilterKind kind, double t) {
    switch (kind) {
        case FilterKind::kBox:
            return 1.0;
        case FilterKind::kTent:
            return 1.0 - t;
        case FilterKind::kGaussian:
            return std::exp(-4.5 * t * t);  // three sigma at the rim
        case FilterKind::kBlackmanHarris: {
            // Four-term window of Harris 1978, table I, centred: its minimum 6e-5 stays positive.
            const double a = kPi<double> * (t + 1.0);
            return 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) -
                   0.01168 * std::cos(3 * a);
        }
    }
    return 0.0;
}

double cell_integral(FilterKind kind, int cell) {
    const double h = 1.0 / (kCells * kSimpson);
    const double t0 = double(cell) / kCells;
    double sum = 0.0;
    for (int i = 0; i <= kSimpson; ++i) {
        const double weight = (i == 0 || i == kSimpson) ? 1.0 : (i % 2 != 0 ? 4.0 : 2.0);
        sum += weight * shape(kind, t0 + i * h);
    }
    return sum * h / 3.0;
}

float default_radius(FilterKind kind) {
    if (kind == FilterKind::kBox) return 0.5F;
    return kind == FilterKind::kTent ? 1.0F : 1.5F;
}

FilterKind parse(std::string_view name) {
    const auto* at = std::find(kFilterNames.begin(), kFilterNames.end(), name);
    if (at == kFilterNames.end())
        throw SceneError("unknown_filter",
                         "filter \"" + std::string(name) +
                             "\" is unknown; use box, tent, gaussian or blackman_harris",
                         "/film/filter");
    return FilterKind(at - kFilterNames.begin());
}

}  // namespace

Filter::Filter(std::string_view name, float radius) : kind_(parse(name)), radius_(radius) {
    if (!(radius_ <= kMaxRadius))
        throw SceneError("bad_filter_radius", "the filter radius must be at most 16 pixels",
                         "/film/filter_radius");
    if (radius_ <= 0.0F) radius_ = default_radius(kind_);
    tabulate();
}

void Filter::tabulate() {
    std::vector<double> cdf(kCells + 1, 0.0);
    for (int i = 0; i < kCells; ++i)
        cdf[std::size_t(i) + 1] = cdf[std::size_t(i)] + cell_integral(kind_, i);
    norm_ = cdf.back();
    if (kind_ == FilterKind::kBox || kind_ == FilterKind::kTent) return;
    cdf_.resize(cdf.size());
    std::transform(cdf.begin(), cdf.end(), cdf_.begin(),
                   [this](double c) { return float(c / norm_); });
    cdf_.back() = 1.0F;
    for (int bin = 0; bin <= kBins; ++bin)
        first_.push_back(std::uint16_t(
            std::upper_bound(cdf_.begin() + 1, cdf_.end() - 1, float(bin) / kBins) - cdf_.begin()));
}

double Filter::density(double x) const {
    const double t = std::abs(x) / double(radius_);
    return t > 1.0 ? 0.0 : shape(kind_, t) / (2.0 * norm_ * double(radius_));
}

float Filter::sample_1d(float u) const {
    const float side = 2.0F * u - 1.0F;  // exact in float: the sign is the half, |side| the variate
    const float v = std::abs(side);
    float t = v;
    if (kind_ == FilterKind::kTent) {
        t = v / (1.0F + std::sqrt(1.0F - v));  // 1 - sqrt(1 - v) without cancellation
    } else if (!cdf_.empty()) {
        const auto bin = std::size_t(std::min(int(v * kBins), kBins - 1));
        const auto above =
            std::upper_bound(cdf_.begin() + first_[bin], cdf_.begin() + first_[bin + 1], v);
        const float c0 = *(above - 1);
        const float width = *above - c0;
        const float inside = width > 0.0F ? std::min((v - c0) / width, 1.0F) : 0.0F;
        t = (float(above - cdf_.begin() - 1) + inside) * (1.0F / kCells);
    }
    return std::copysign(t * radius_, side);
}

}  // namespace matiere
