// Four-dimensional Sobol points with nested uniform (Owen) scrambling by hashing.
// Sources: Joe & Kuo 2008 (direction numbers), Owen 1995 (nested scrambling), Laine & Karras 2011
// and Burley 2020 "Practical Hash-based Owen Scrambling" (hashing and index shuffling), with the
// hash constants of Vegdahl 2021.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include "base/rng.h"

namespace matiere {

namespace sobol_detail {

using Column = std::array<std::uint32_t, 4>;

/// Direction numbers of one dimension from its primitive polynomial (degree s, coefficients a) and
/// initial numbers m (Joe & Kuo 2008); s = 0 is the van der Corput sequence.
constexpr std::array<std::uint32_t, 32> directions(int s, unsigned a, std::array<unsigned, 3> m) {
    std::array<std::uint32_t, 32> v{};
    for (int i = 0; i < 32; ++i) {
        if (s == 0) {
            v[std::size_t(i)] = 1U << (31 - i);
        } else if (i < s) {
            v[std::size_t(i)] = m[std::size_t(i)] << (31 - i);
        } else {
            std::uint32_t x = v[std::size_t(i - s)] ^ (v[std::size_t(i - s)] >> s);
            for (int k = 1; k < s; ++k)
                if ((a >> (s - 1 - k)) & 1U) x ^= v[std::size_t(i - k)];
            v[std::size_t(i)] = x;
        }
    }
    return v;
}

constexpr std::array<Column, 32> columns() {
    const auto d0 = directions(0, 0, {});
    const auto d1 = directions(1, 0, {1, 0, 0});
    const auto d2 = directions(2, 1, {1, 3, 0});
    const auto d3 = directions(3, 1, {1, 3, 1});
    std::array<Column, 32> c{};
    for (std::size_t i = 0; i < 32; ++i) c[i] = {d0[i], d1[i], d2[i], d3[i]};
    return c;
}

inline constexpr std::array<Column, 32> kColumns = columns();

}  // namespace sobol_detail

constexpr std::uint32_t reverse_bits(std::uint32_t x) {
    x = __builtin_bswap32(x);
    x = ((x & 0x0f0f0f0fU) << 4) | ((x >> 4) & 0x0f0f0f0fU);
    x = ((x & 0x33333333U) << 2) | ((x >> 2) & 0x33333333U);
    return ((x & 0x55555555U) << 1) | ((x >> 1) & 0x55555555U);
}

/// Owen scrambling of bit-reversed values: each bit is flipped by a hash of the bits below it.
constexpr std::uint32_t owen_hash_reversed(std::uint32_t x, std::uint32_t seed) {
    x ^= x * 0x3d20adeaU;
    x += seed;
    x *= (seed >> 16) | 1U;
    x ^= x * 0x05526c56U;
    return x ^ (x * 0x53a22864U);
}

constexpr std::uint32_t owen_scramble(std::uint32_t x, std::uint32_t seed) {
    return reverse_bits(owen_hash_reversed(reverse_bits(x), seed));
}

/// A nested permutation of the index that maps every [0, 2^k) onto itself, so that shuffled blocks
/// keep the prefix property. The constant xor removes the leading bits that Owen scrambling would
/// set: a digital shift changes no distribution, and small indices stay small, so that a point
/// costs log2(index) steps instead of 32.
constexpr std::uint32_t shuffle_index(std::uint32_t index, std::uint32_t seed) {
    return owen_scramble(index, seed) ^ owen_scramble(0, seed);
}

/// Point `index` of the 4-D Sobol sequence as 0.32 fixed point, unscrambled.
constexpr std::array<std::uint32_t, 4> sobol4(std::uint32_t index) {
    std::array<std::uint32_t, 4> x{};
    for (; index != 0; index &= index - 1) {
        const auto& c = sobol_detail::kColumns[std::size_t(std::countr_zero(index))];
        for (std::size_t d = 0; d < 4; ++d) x[d] ^= c[d];
    }
    return x;
}

}  // namespace matiere
