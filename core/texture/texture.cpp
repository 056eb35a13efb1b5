#include "texture/texture.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"

namespace matiere {

Wrap wrap_from_name(const std::string& name, const std::string& pointer) {
    if (name == "repeat") return Wrap::kRepeat;
    if (name == "clamp") return Wrap::kClamp;
    if (name == "mirror") return Wrap::kMirror;
    if (name == "black") return Wrap::kBlack;
    throw SceneError("bad_value",
                     "wrap is '" + name + "'; use 'repeat', 'clamp', 'mirror' or 'black'", pointer);
}

TextureFilter filter_from_name(const std::string& name, const std::string& pointer) {
    if (name == "nearest") return TextureFilter::kNearest;
    if (name == "bilinear") return TextureFilter::kBilinear;
    if (name == "trilinear") return TextureFilter::kTrilinear;
    throw SceneError("bad_value",
                     "filter is '" + name + "'; use 'nearest', 'bilinear' or 'trilinear'", pointer);
}

ImageTexture::ImageTexture(TexelGrid texels, const TextureOptions& options,
                           const std::string& pointer)
    : options_(options) {
    if (!texels.complete())
        throw SceneError("bad_texture",
                         "a texture needs height x width x 3 values, at least one pixel", pointer);
    const UvTransform& t = options_.transform;
    const float det = std::abs(t.determinant());
    if (!(det > 0.0F) || !std::isfinite(det) || !std::isfinite(t.offset.x + t.offset.y))
        throw SceneError("bad_texture", "the texture's transform flattens it to a line", pointer);
    texels_per_area_ = det * float(texels.width) * float(texels.height);
    moved_ = !t.is_identity();
    levels_.push_back(std::move(texels));
    find_range();
    if (!minimum_.is_finite() || !maximum_.is_finite() || !mean_.is_finite())
        throw SceneError("bad_texture", "the texture holds NaN or infinite values", pointer);
    if (options_.filter == TextureFilter::kTrilinear)
        for (TexelGrid& level : mip_levels(levels_[0])) levels_.push_back(std::move(level));
}

void ImageTexture::find_range() {
    const TexelGrid& grid = levels_[0];
    with_reader(grid, [&](const auto& read) {
        minimum_ = maximum_ = read(0, 0);
        Spectrumd sum;
        for (int y = 0; y < grid.height; ++y)
            for (int x = 0; x < grid.width; ++x) {
                const Spectrumf texel = read(x, y);
                for (int lane = 0; lane < 3; ++lane) {
                    minimum_[lane] = std::min(minimum_[lane], texel[lane]);
                    maximum_[lane] = std::max(maximum_[lane], texel[lane]);
                    sum[lane] += double(texel[lane]);
                }
            }
        mean_ = spectrum_cast<float>(sum * (1.0 / (double(grid.width) * double(grid.height))));
    });
    if (options_.wrap != Wrap::kBlack) return;
    for (int lane = 0; lane < 3; ++lane) {
        minimum_[lane] = std::min(minimum_[lane], 0.0F);
        maximum_[lane] = std::max(maximum_[lane], 0.0F);
    }
}

std::size_t ImageTexture::bytes() const {
    std::size_t sum = 0;
    for (const TexelGrid& level : levels_) sum += level.bytes.size();
    return sum;
}

Vec2f ImageTexture::coordinates(Vec2f uv) const {
    if (!moved_) return uv;
    const UvTransform& t = options_.transform;
    return Vec2f{t.a * uv.x + t.b * uv.y, t.c * uv.x + t.d * uv.y} + t.offset;
}

Spectrumf ImageTexture::lookup(const TexturePoint& at) const {
    if (levels_.size() == 1) return fine(at);
    const auto set = std::size_t(options_.uv_set);
    const Vec2f uv = coordinates(at.uv[set]);
    const float level = 0.5F * std::log2(at.area[set] * texels_per_area_);
    if (!(level > 0.0F)) return bilinear(levels_[0], uv);
    const std::size_t last = levels_.size() - 1;
    if (level >= float(last)) return bilinear(levels_[last], uv);
    const auto i = std::size_t(level);
    const float w = level - float(i);
    return bilinear(levels_[i], uv) * (1.0F - w) + bilinear(levels_[i + 1], uv) * w;
}

Spectrumf ImageTexture::fine(const TexturePoint& at) const {
    return fine_at(coordinates(at.uv[std::size_t(options_.uv_set)]));
}

Spectrumf ImageTexture::fine_at(Vec2f coordinates) const {
    return options_.filter == TextureFilter::kNearest ? nearest(levels_[0], coordinates)
                                                      : bilinear(levels_[0], coordinates);
}

/// Into one period first: far from the origin u * width would lose its fraction.
Vec2f ImageTexture::folded(Vec2f uv) const {
    const auto fold = [this](float x) {
        switch (options_.wrap) {
            case Wrap::kRepeat:
                return x - std::floor(x);
            case Wrap::kMirror: {
                const float y = x - 2.0F * std::floor(0.5F * x);
                return y > 1.0F ? 2.0F - y : y;
            }
            case Wrap::kBlack:
                return std::clamp(x, -2.0F, 3.0F);  // all black out there
            default:
                return std::clamp(x, 0.0F, 1.0F);
        }
    };
    return {fold(uv.x), fold(uv.y)};
}

/// The column or row of a texel, or -1 where there is none.
int ImageTexture::wrapped(int i, int n) const {
    if (options_.wrap == Wrap::kBlack) return i < 0 || i >= n ? -1 : i;
    if (options_.wrap != Wrap::kRepeat) return std::clamp(i, 0, n - 1);
    const int m = i % n;
    return m < 0 ? m + n : m;
}

Spectrumf ImageTexture::bilinear(const TexelGrid& grid, Vec2f uv) const {
    const Vec2f at = folded(uv);
    const Vec2f in = std::isfinite(at.x) && std::isfinite(at.y) ? at : Vec2f{0.0F, 1.0F};
    const float x = in.x * float(grid.width) - 0.5F;
    const float y = (1.0F - in.y) * float(grid.height) - 0.5F;
    const float fx = std::floor(x), fy = std::floor(y);
    const int x0 = wrapped(int(fx), grid.width), x1 = wrapped(int(fx) + 1, grid.width);
    const int y0 = wrapped(int(fy), grid.height), y1 = wrapped(int(fy) + 1, grid.height);
    const float wx = x - fx, wy = y - fy;
    return with_reader(grid, [&](const auto& read) {
        const auto texel = [&](int i, int j) { return i < 0 || j < 0 ? Spectrumf() : read(i, j); };
        const Spectrumf top = texel(x0, y0) * (1.0F - wx) + texel(x1, y0) * wx;
        const Spectrumf bottom = texel(x0, y1) * (1.0F - wx) + texel(x1, y1) * wx;
        return top * (1.0F - wy) + bottom * wy;
    });
}

Spectrumf ImageTexture::nearest(const TexelGrid& grid, Vec2f uv) const {
    const Vec2f at = folded(uv);
    const Vec2f in = std::isfinite(at.x) && std::isfinite(at.y) ? at : Vec2f{0.0F, 1.0F};
    const int x = wrapped(int(std::floor(in.x * float(grid.width))), grid.width);
    const int y = wrapped(int(std::floor((1.0F - in.y) * float(grid.height))), grid.height);
    if (x < 0 || y < 0) return {};
    return with_reader(grid, [&](const auto& read) { return read(x, y); });
}

}  // namespace matiere
