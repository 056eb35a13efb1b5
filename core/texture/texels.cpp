#include "texture/texels.h"

#include <algorithm>
#include <cmath>

namespace matiere {
namespace {

std::array<float, 256> srgb_table() {
    std::array<float, 256> table{};
    for (std::size_t i = 0; i < table.size(); ++i) {
        const double x = double(i) / 255.0;
        table[i] = float(x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4));
    }
    return table;
}

/// What part of which source texels one texel of a smaller row covers.
struct Cover {
    int first = 0, count = 0;
    std::array<double, 4> weight{};
};

std::vector<Cover> covers(int from, int to) {
    std::vector<Cover> out(static_cast<std::size_t>(to));
    const double step = double(from) / double(to);
    for (int i = 0; i < to; ++i) {
        const double low = step * i, high = std::min(step * (i + 1), double(from));
        Cover& c = out[std::size_t(i)];
        c.first = int(std::floor(low));
        for (int k = c.first; double(k) < high && c.count < 4; ++k)
            c.weight[std::size_t(c.count++)] =
                (std::min(high, double(k + 1)) - std::max(low, double(k))) / (high - low);
    }
    return out;
}

TexelFormat averaged_format(TexelFormat format) {
    const bool bytes = format == TexelFormat::kByte || format == TexelFormat::kByteSrgb;
    return bytes ? TexelFormat::kHalf : format;
}

void encode_texel(TexelFormat format, double value, std::byte* at) {
    if (format == TexelFormat::kFloat) {
        const auto v = float(value);
        std::memcpy(at, &v, sizeof v);
        return;
    }
    const std::uint16_t v = format == TexelFormat::kHalf
                                ? std::uint16_t(_cvtss_sh(float(value), _MM_FROUND_TO_NEAREST_INT))
                                : std::uint16_t(std::lround(std::clamp(value, 0.0, 1.0) * 65535.0));
    std::memcpy(at, &v, sizeof v);
}

TexelGrid as_format(const TexelGrid& grid, TexelFormat format) {
    TexelGrid out{grid.width, grid.height, grid.channels, format, {}};
    const std::size_t values =
        std::size_t(grid.width) * std::size_t(grid.height) * std::size_t(grid.channels);
    out.bytes.resize(values * texel_bytes(format));
    with_reader(grid, [&](const auto& read) {
        std::byte* at = out.bytes.data();
        for (int y = 0; y < grid.height; ++y)
            for (int x = 0; x < grid.width; ++x) {
                const Spectrumf texel = read(x, y);
                for (int c = 0; c < grid.channels; ++c, at += texel_bytes(format))
                    encode_texel(format, double(texel[c]), at);
            }
    });
    return out;
}

}  // namespace

const std::array<float, 256> kSrgbToLinear = srgb_table();

TexelGrid half_size(const TexelGrid& grid, TexelFormat format) {
    TexelGrid out{
        std::max(grid.width / 2, 1), std::max(grid.height / 2, 1), grid.channels, format, {}};
    const std::size_t size = texel_bytes(out.format);
    const auto channels = std::size_t(grid.channels);
    out.bytes.resize(std::size_t(out.width) * std::size_t(out.height) * channels * size);
    const auto columns = covers(grid.width, out.width), rows = covers(grid.height, out.height);
    with_reader(grid, [&](const auto& read) {
        std::byte* at = out.bytes.data();
        for (const Cover& row : rows)
            for (const Cover& column : columns) {
                std::array<double, 3> sum{};
                for (int y = 0; y < row.count; ++y)
                    for (int x = 0; x < column.count; ++x) {
                        const Spectrumf texel = read(column.first + x, row.first + y);
                        const double w = row.weight[std::size_t(y)] * column.weight[std::size_t(x)];
                        for (std::size_t c = 0; c < channels; ++c)
                            sum[c] += w * double(texel[int(c)]);
                    }
                for (std::size_t c = 0; c < channels; ++c, at += size)
                    encode_texel(out.format, sum[c], at);
            }
    });
    return out;
}

std::vector<TexelGrid> mip_levels(const TexelGrid& grid) {
    std::vector<TexelGrid> levels;
    if (grid.width == 1 && grid.height == 1) return levels;
    const TexelFormat format = averaged_format(grid.format);
    levels.push_back(half_size(grid, format));
    // The rest from floats, so that roundings do not add up.
    TexelGrid exact = as_format(levels[0], TexelFormat::kFloat);
    while (exact.width > 1 || exact.height > 1) {
        exact = half_size(exact, TexelFormat::kFloat);
        levels.push_back(as_format(exact, format));
    }
    return levels;
}

}  // namespace matiere
