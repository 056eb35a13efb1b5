// Texels in the format of their file: 8-bit (sRGB or plain), 16-bit, half or float; one channel or
// three. They become linear floats at lookup.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include <immintrin.h>

#include "base/spectrum.h"

namespace matiere {

enum class TexelFormat : unsigned char { kByte, kByteSrgb, kShort, kHalf, kFloat };

constexpr std::size_t texel_bytes(TexelFormat format) {
    if (format == TexelFormat::kByte || format == TexelFormat::kByteSrgb) return 1;
    return format == TexelFormat::kFloat ? 4 : 2;
}

/// Linear values of the 256 codes (IEC 61966-2-1).
extern const std::array<float, 256> kSrgbToLinear;

/// Rows from the top, `channels` values a texel.
struct TexelGrid {
    int width = 0, height = 0, channels = 3;
    TexelFormat format = TexelFormat::kFloat;
    std::vector<std::byte> bytes;

    bool complete() const {
        return width > 0 && height > 0 && (channels == 1 || channels == 3) &&
               bytes.size() == std::size_t(width) * std::size_t(height) * std::size_t(channels) *
                                   texel_bytes(format);
    }
};

template <TexelFormat F>
inline float decode_texel(const std::byte* at) {
    if constexpr (F == TexelFormat::kByte) return float(std::uint8_t(*at)) * (1.0F / 255.0F);
    if constexpr (F == TexelFormat::kByteSrgb) return kSrgbToLinear[std::uint8_t(*at)];
    if constexpr (F == TexelFormat::kFloat) {
        float value = 0;
        std::memcpy(&value, at, sizeof value);
        return value;
    }
    std::uint16_t bits = 0;
    std::memcpy(&bits, at, sizeof bits);
    return F == TexelFormat::kHalf ? _cvtsh_ss(bits) : float(bits) * (1.0F / 65535.0F);
}

/// A grid as code for one format and channel count.
template <TexelFormat F, int Channels>
class GridReader {
 public:
    explicit GridReader(const TexelGrid& grid) : grid_(grid) {}
    Spectrumf operator()(int x, int y) const {
        constexpr std::size_t kSize = texel_bytes(F);
        const std::size_t texel = std::size_t(y) * std::size_t(grid_.width) + std::size_t(x);
        const std::byte* at = grid_.bytes.data() + texel * std::size_t(Channels) * kSize;
        const float r = decode_texel<F>(at);
        if constexpr (Channels == 1)
            return {r, r, r};
        else
            return {r, decode_texel<F>(at + kSize), decode_texel<F>(at + 2 * kSize)};
    }

 private:
    const TexelGrid& grid_;
};

/// Calls `f` with the reader of a grid.
template <class Fn>
auto with_reader(const TexelGrid& grid, Fn&& f) {
    const auto of = [&]<TexelFormat F>() {
        return grid.channels == 1 ? f(GridReader<F, 1>(grid)) : f(GridReader<F, 3>(grid));
    };
    switch (grid.format) {
        case TexelFormat::kByte:
            return of.template operator()<TexelFormat::kByte>();
        case TexelFormat::kByteSrgb:
            return of.template operator()<TexelFormat::kByteSrgb>();
        case TexelFormat::kShort:
            return of.template operator()<TexelFormat::kShort>();
        case TexelFormat::kHalf:
            return of.template operator()<TexelFormat::kHalf>();
        default:
            return of.template operator()<TexelFormat::kFloat>();
    }
}

/// Half the size, at least one texel on an edge, every texel the mean of the area it covers (also
/// where a size is odd), so that all levels have the same mean (Williams 1983).
TexelGrid half_size(const TexelGrid& grid, TexelFormat format);

/// The levels below `grid`, down to a single texel. Those of 8-bit texels are half floats: rounded
/// to 8 bits the mean of black and white would be 0.3 % off.
std::vector<TexelGrid> mip_levels(const TexelGrid& grid);

}  // namespace matiere
