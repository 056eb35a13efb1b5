#include "film/worth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "film/estimate.h"
#include "film/film.h"
#include "film/pixel_pairs.h"

namespace matiere {
namespace {

constexpr int kC = kColorChannels;

struct Moments {
    std::array<double, kC> mean{}, variance{};
};

/// Mean and variance of the mean, pixel by pixel, of one half of the replicates of a tile.
class StripMoments {
 public:
    StripMoments(const Film& film, int strip)
        : chunk_(film.plan().chunk(std::uint32_t(strip))), values_(std::size_t(chunk_.pixels())) {
        for (int y = 0; y < chunk_.height(); ++y)
            for (int x = 0; x < chunk_.width(); ++x) {
                const std::size_t pixel = std::size_t(chunk_.y0 + y) * std::size_t(film.width()) +
                                          std::size_t(chunk_.x0 + x);
                values_[std::size_t(y * chunk_.width() + x)] = moments(film, pixel);
            }
    }

    const Chunk& chunk() const { return chunk_; }
    const Moments& at(int x, int y) const { return values_[std::size_t(y * chunk_.width() + x)]; }

    /// S around a pixel and its variance, of the pixels inside the tile but for the pixel itself.
    Moments around(int x, int y) const {
        Moments s;
        double n = 0.0;
        for (int v = std::max(y - kSmoothRadius, 0);
             v <= std::min(y + kSmoothRadius, chunk_.height() - 1); ++v)
            for (int u = std::max(x - kSmoothRadius, 0);
                 u <= std::min(x + kSmoothRadius, chunk_.width() - 1); ++u) {
                if (u == x && v == y) continue;
                for (std::size_t c = 0; c < kC; ++c) {
                    s.mean[c] += at(u, v).mean[c];
                    s.variance[c] += at(u, v).variance[c];
                }
                n += 1.0;
            }
        if (n == 0.0) return at(x, y);
        for (std::size_t c = 0; c < kC; ++c) {
            s.mean[c] /= n;
            s.variance[c] /= n * n;
        }
        return s;
    }

 private:
    Moments moments(const Film& film, std::size_t pixel) const {
        const double n = chunk_.replicates();
        Moments m;
        for (std::size_t c = 0; c < kC; ++c) {
            for (int r = chunk_.r0; r < chunk_.r1; ++r)
                m.mean[c] += film.camera_mean(pixel, int(c), r) / n;
            for (int r = chunk_.r0; r < chunk_.r1; ++r)
                m.variance[c] +=
                    sqr(film.camera_mean(pixel, int(c), r) - m.mean[c]) / (n * (n - 1.0));
        }
        return m;
    }

    Chunk chunk_;
    std::vector<Moments> values_;
};

double luminance(const std::array<double, kC>& rgb) {
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

}  // namespace

double half_floor(const Film& film, int half) {
    double sum = 0.0, n = 0.0;
    for (int tile = 0; tile < film.plan().tiles(); ++tile) {
        const StripMoments strip(film, half * film.plan().tiles() + tile);
        for (int y = 0; y < strip.chunk().height(); ++y)
            for (int x = 0; x < strip.chunk().width(); ++x)
                if (const double lum = luminance(strip.around(x, y).mean); lum > 0.0) {
                    sum += std::log(lum);
                    n += 1.0;
                }
    }
    return n == 0.0 ? 0.0 : kRelativeFloor * sqr(std::exp(sum / n));
}

double strip_worth(const Film& film, int strip, double floor, std::uint64_t rays) {
    const StripMoments moments(film, strip);
    const Chunk& chunk = moments.chunk();
    double variance = 0.0;
    for (int y = 0; y < chunk.height(); ++y)
        for (int x = 0; x < chunk.width(); ++x) {
            const Moments s = moments.around(x, y);
            for (std::size_t c = 0; c < kC; ++c)
                variance += moments.at(x, y).variance[c] *
                            reciprocal_scale(s.mean[c], s.variance[c], floor);
        }
    // Both the variance of one sample and the rays of one sample are taken of all n samples.
    const auto pixel = std::size_t(chunk.y0) * std::size_t(film.width()) + std::size_t(chunk.x0);
    const double n = film.count(pixel, chunk.r0);
    return rays == 0 || !std::isfinite(variance) ? 0.0 : n * std::sqrt(variance / double(rays));
}

}  // namespace matiere
