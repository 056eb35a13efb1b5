// Four-dimensional Sobol points with nested uniform (Owen) scrambling by hashing.
// Sources: Joe & Kuo 2008 (direction numbers), Owen 1995 (nested scrambling), Laine & Karras 2011
// and Burley 2020 "Practical Hash-based Owen Scrambling" (hashing and index shuffling), with the
// hash constants of Vegdahl 2021.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include <immintrin.h>

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

/// The best pair of dimensions, a (0, 2)-sequence, comes second and third: there a block holds what
/// is sampled in two dimensions, after a choice.
constexpr std::array<Column, 32> columns() {
    const auto d0 = directions(0, 0, {});
    const auto d1 = directions(1, 0, {1, 0, 0});
    const auto d2 = directions(2, 1, {1, 3, 0});
    const auto d3 = directions(3, 1, {1, 3, 1});
    std::array<Column, 32> c{};
    for (std::size_t i = 0; i < 32; ++i) c[i] = {d2[i], d0[i], d1[i], d3[i]};
    return c;
}

inline constexpr std::array<Column, 32> kColumns = columns();

}  // namespace sobol_detail

/// Four numbers of 32 bits that are worked on together.
using Quad = std::uint32_t __attribute__((vector_size(16)));

constexpr std::uint32_t reverse_bits(std::uint32_t x) {
    x = __builtin_bswap32(x);
    x = ((x & 0x0f0f0f0fU) << 4) | ((x >> 4) & 0x0f0f0f0fU);
    x = ((x & 0x33333333U) << 2) | ((x >> 2) & 0x33333333U);
    return ((x & 0x55555555U) << 1) | ((x >> 1) & 0x55555555U);
}

inline Quad reverse_bits(Quad x) {
    // The two halves of a byte by a table each, then the bytes of a number in reverse.
    const __m128i low =
        _mm_setr_epi8(0, -128, 64, -64, 32, -96, 96, -32, 16, -112, 80, -48, 48, -80, 112, -16);
    const __m128i high = _mm_setr_epi8(0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15);
    const __m128i swap = _mm_setr_epi8(3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12);
    const __m128i nibble = _mm_set1_epi8(15), v = __m128i(x);
    const __m128i reversed =
        _mm_or_si128(_mm_shuffle_epi8(low, _mm_and_si128(v, nibble)),
                     _mm_shuffle_epi8(high, _mm_and_si128(_mm_srli_epi16(v, 4), nibble)));
    return Quad(_mm_shuffle_epi8(reversed, swap));
}

/// Owen scrambling of bit-reversed values: each bit is flipped by a hash of the bits below it.
template <class T>
constexpr T owen_hash_reversed(T x, T seed) {
    x ^= x * 0x3d20adeaU;
    x += seed;
    x *= (seed >> 16) | 1U;
    x ^= x * 0x05526c56U;
    return x ^ (x * 0x53a22864U);
}

namespace sobol_detail {

constexpr std::array<Column, 32> reversed_columns() {
    auto c = kColumns;
    for (auto& column : c)
        for (auto& x : column) x = reverse_bits(x);
    return c;
}

alignas(16) inline constexpr std::array<Column, 32> kReversedColumns = reversed_columns();

}  // namespace sobol_detail

/// Point `index` of the 4-D Sobol sequence as 0.32 fixed point, its index shuffled and its
/// coordinates scrambled by the seeds; takes the index with its bits reversed, and works on
/// reversed numbers throughout. The shuffle is a nested permutation of the index that maps every
/// [0, 2^k) onto itself, so that shuffled blocks keep the prefix property. The constant xor removes
/// the leading bits that Owen scrambling would set: a digital shift changes no distribution, and
/// small indices stay small, so that a point costs log2(index) steps instead of 32.
inline std::array<std::uint32_t, 4> scrambled_sobol4(std::uint32_t reversed_index,
                                                     std::uint32_t shuffle_seed, Quad seeds) {
    std::uint32_t index = reverse_bits(owen_hash_reversed(reversed_index, shuffle_seed) ^
                                       owen_hash_reversed(0U, shuffle_seed));
    Quad x{};
    for (; index != 0; index &= index - 1) {
        const auto& c = sobol_detail::kReversedColumns[std::size_t(std::countr_zero(index))];
        x ^= std::bit_cast<Quad>(c);
    }
    return std::bit_cast<std::array<std::uint32_t, 4>>(reverse_bits(owen_hash_reversed(x, seeds)));
}

}  // namespace matiere
