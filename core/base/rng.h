// Hashes and a small generator. Everything random in a render is a pure function of its
// coordinates (seed, replicate, pixel, index, dimension); nothing keeps state between samples.
#pragma once

#include <cstdint>

namespace matiere {

/// 64-bit finaliser (Stafford 2011, variant 13), as used by SplitMix64.
constexpr std::uint64_t mix64(std::uint64_t z) {
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
}

/// 32-bit finaliser (Wellons 2018, "lowbias32").
constexpr std::uint32_t mix32(std::uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352dU;
    x ^= x >> 15;
    x *= 0x846ca68bU;
    return x ^ (x >> 16);
}

template <class... Words>
constexpr std::uint64_t hash_words(std::uint64_t seed, Words... words) {
    std::uint64_t h = mix64(seed + 0x9e3779b97f4a7c15ULL);
    ((h = mix64(h ^ (std::uint64_t(words) + 0x9e3779b97f4a7c15ULL + (h << 6) + (h >> 2)))), ...);
    return h;
}

/// Uniform float in [0, 1) from the upper 24 bits: exact, never rounds up to 1.
constexpr float unit_float(std::uint32_t x) { return float(x >> 8) * 0x1p-24F; }

/// PCG32 (O'Neill 2014): for scene-building and tests, not for samples.
class Pcg32 {
 public:
    explicit Pcg32(std::uint64_t seed, std::uint64_t stream = 0) : increment_((stream << 1) | 1) {
        next();
        state_ += seed;
        next();
    }
    std::uint32_t next() {
        const std::uint64_t old = state_;
        state_ = old * 6364136223846793005ULL + increment_;
        const auto shifted = std::uint32_t(((old >> 18) ^ old) >> 27);
        const auto rotation = std::uint32_t(old >> 59);
        return (shifted >> rotation) | (shifted << ((32 - rotation) & 31));
    }
    float uniform() { return unit_float(next()); }

 private:
    std::uint64_t state_ = 0;
    std::uint64_t increment_;
};

}  // namespace matiere
