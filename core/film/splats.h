// Light that paths from the lights bring to pixels: sums by pixel, as sparse as the paths are.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "film/filter.h"

namespace matiere {

inline constexpr int kSplatChannels = 3;  ///< R, G, B; alpha is the camera's
inline constexpr int kSplatLobes = 2;  ///< told apart: diffuse, transmission; the rest is specular

/// The sums of one chunk and replicate. Order of `add` is the order of the additions in a pixel.
class SplatSums {
 public:
    using Value = std::array<double, kSplatChannels>;

    void add(std::uint32_t pixel, const Value& value) {
        if (2 * (pixels_.size() + 1) > slots_.size()) grow();
        std::uint32_t& slot = find(pixel);
        if (slot == 0) {
            pixels_.push_back(pixel);
            sums_.push_back(value);
            slot = std::uint32_t(pixels_.size());
            return;
        }
        Value& sum = sums_[slot - 1];
        for (std::size_t c = 0; c < sum.size(); ++c) sum[c] += value[c];
    }

    /// Every pixel once, and its sum.
    const std::vector<std::uint32_t>& pixels() const { return pixels_; }
    const std::vector<Value>& sums() const { return sums_; }

 private:
    std::uint32_t& find(std::uint32_t pixel) {
        const std::size_t mask = slots_.size() - 1;
        std::size_t at = (std::size_t(pixel) * 0x9e3779b97f4a7c15ULL >> 20) & mask;
        while (slots_[at] != 0 && pixels_[slots_[at] - 1] != pixel) at = (at + 1) & mask;
        return slots_[at];
    }
    void grow() {
        slots_.assign(slots_.empty() ? 256 : 2 * slots_.size(), 0);
        for (std::size_t i = 0; i < pixels_.size(); ++i) find(pixels_[i]) = std::uint32_t(i + 1);
    }

    std::vector<std::uint32_t> slots_, pixels_;  // slot: index + 1 of its entry, 0 where free
    std::vector<Value> sums_;
};

/// The stored pixels [x0, x1) x [y0, y1) of a film as light paths see them.
struct SplatWindow {
    const Filter* filter;
    int x0, y0, x1, y1;

    int pixels() const { return (x1 - x0) * (y1 - y0); }
    bool near(Vec2f raster) const {
        const float r = filter->radius();
        return raster.x > float(x0) - r && raster.x < float(x1) + r && raster.y > float(y0) - r &&
               raster.y < float(y1) + r;
    }
    /// Calls f(pixel, weight) for every pixel that the raster position lies in the filter of.
    template <class F>
    void for_each_pixel(Vec2f raster, F&& f) const {
        const float r = filter->radius();
        const auto first = [r](float at, int least) {
            return std::max(int(std::floor(at - r - 0.5F)), least);
        };
        const auto last = [r](float at, int most) {
            return std::min(int(std::ceil(at + r - 0.5F)), most - 1);
        };
        // Half open: a place just between two pixels of a box is not lost.
        const auto offset = [r](float at, int pixel) {
            const float d = at - (float(pixel) + 0.5F);
            return d == -r ? std::nextafter(d, 0.0F) : d;
        };
        for (int y = first(raster.y, y0); y <= last(raster.y, y1); ++y) {
            const float wy = filter->weight(offset(raster.y, y));
            if (!(wy > 0)) continue;
            for (int x = first(raster.x, x0); x <= last(raster.x, x1); ++x) {
                const auto w = double(wy * filter->weight(offset(raster.x, x)));
                if (!(w > 0)) continue;
                f(std::uint32_t(y - y0) * std::uint32_t(x1 - x0) + std::uint32_t(x - x0), w);
            }
        }
    }
};

}  // namespace matiere
