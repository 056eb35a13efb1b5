#include "texture/texture.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"

namespace matiere {

Wrap wrap_from_name(const std::string& name, const std::string& pointer) {
    if (name == "repeat") return Wrap::kRepeat;
    if (name == "clamp") return Wrap::kClamp;
    throw SceneError("bad_value", "wrap is '" + name + "'; use 'repeat' or 'clamp'", pointer);
}

ImageTexture::ImageTexture(int width, int height, std::vector<float> rgb, Wrap wrap,
                           const std::string& pointer)
    : width_(width), height_(height), texels_(std::move(rgb)), wrap_(wrap) {
    if (width < 1 || height < 1 || texels_.size() != std::size_t(width) * std::size_t(height) * 3)
        throw SceneError("bad_texture",
                         "a texture needs height x width x 3 values, at least one pixel", pointer);
    for (const float v : texels_)
        if (!std::isfinite(v))
            throw SceneError("bad_texture", "the texture holds NaN or infinite values", pointer);
    minimum_ = maximum_ = texel(0, 0);
    Spectrumd sum;
    for (std::size_t i = 0; i < texels_.size(); ++i) {
        const int lane = int(i % 3);
        minimum_[lane] = std::min(minimum_[lane], texels_[i]);
        maximum_[lane] = std::max(maximum_[lane], texels_[i]);
        sum[lane] += double(texels_[i]);
    }
    mean_ = spectrum_cast<float>(sum * (3.0 / double(texels_.size())));
}

int ImageTexture::wrapped(int i, int n) const {
    if (wrap_ == Wrap::kClamp) return std::clamp(i, 0, n - 1);
    const int m = i % n;
    return m < 0 ? m + n : m;
}

Spectrumf ImageTexture::texel(int x, int y) const {
    const float* t = &texels_[(std::size_t(y) * std::size_t(width_) + std::size_t(x)) * 3];
    return {t[0], t[1], t[2]};
}

Spectrumf ImageTexture::lookup(Vec2f uv) const {
    // Into one period first: far from the origin u * width would lose its fraction.
    float u = uv.x, v = uv.y;
    if (wrap_ == Wrap::kRepeat) {
        u -= std::floor(u);
        v -= std::floor(v);
    } else {
        u = std::clamp(u, 0.0F, 1.0F);
        v = std::clamp(v, 0.0F, 1.0F);
    }
    if (!std::isfinite(u) || !std::isfinite(v)) return texel(0, 0);
    const float x = u * float(width_) - 0.5F;
    const float y = (1.0F - v) * float(height_) - 0.5F;
    const float fx = std::floor(x), fy = std::floor(y);
    const int x0 = wrapped(int(fx), width_), x1 = wrapped(int(fx) + 1, width_);
    const int y0 = wrapped(int(fy), height_), y1 = wrapped(int(fy) + 1, height_);
    const float wx = x - fx, wy = y - fy;
    const Spectrumf top = texel(x0, y0) * (1.0F - wx) + texel(x1, y0) * wx;
    const Spectrumf bottom = texel(x0, y1) * (1.0F - wx) + texel(x1, y1) * wx;
    return top * (1.0F - wy) + bottom * wy;
}

}  // namespace matiere
