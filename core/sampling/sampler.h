// The sample source of a path: a pure function of (seed, replicate, pixel, index, slot).
// Sobol points are padded in 4-D blocks, one block per (bounce, purpose), each block with its own
// index shuffle and scrambling (Burley 2020), so any path length works and slots never move: two
// sweep cells that differ in a material use the same random numbers.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include "base/rng.h"
#include "base/vec.h"
#include "sampling/sobol.h"

namespace matiere {

/// What a block of four numbers is for. Every bounce owns kCount blocks, used or not.
enum class Purpose : std::uint32_t {
    kFilm = 0,   ///< bounce 0 only: lens, pixel filter (2), lens
    kBsdf = 1,   ///< lobe choice, direction (2), roulette
    kLight = 2,  ///< light choice, position (2), part of the light
    kSpare = 3,  ///< opacity, dispersion
    kCount = 4
};

/// Four coordinates in 0.32 fixed point.
struct SampleBlock {
    std::array<std::uint32_t, 4> bits;
    float uniform(int i) const { return unit_float(bits[std::size_t(i)]); }
    Vec2f uniform2(int i) const { return {uniform(i), uniform(i + 1)}; }
    Vec3f uniform3(int i) const { return {uniform(i), uniform(i + 1), uniform(i + 2)}; }
};

class Sampler {
 public:
    /// Pixels are scrambled independently (no screen-space blue noise): intervals pooled over
    /// pixels rest on that. `index` counts samples inside the replicate.
    Sampler(std::uint64_t seed, std::uint32_t replicate, int x, int y, std::uint64_t index)
        : key_(
              hash_words(seed, replicate,
                         std::uint64_t(std::uint32_t(x)) | (std::uint64_t(std::uint32_t(y)) << 32U),
                         index >> 32U)),
          reversed_index_(reverse_bits(std::uint32_t(index))) {}

    SampleBlock block(std::uint32_t bounce, Purpose purpose) const {
        const std::uint64_t slot =
            std::uint64_t(bounce) * unsigned(Purpose::kCount) + unsigned(purpose);
        const std::uint64_t h = mix64(key_ + (slot + 1) * 0x9e3779b97f4a7c15ULL);
        const std::uint64_t g = mix64(h ^ 0xd1b54a32d192ed03ULL);
        const auto shuffle_seed = std::uint32_t(mix64(g + h) >> 32U);
        const Quad seeds = std::bit_cast<Quad>(std::array{h, g});
        return {scrambled_sobol4(reversed_index_, shuffle_seed, seeds)};
    }

 private:
    std::uint64_t key_;
    std::uint32_t reversed_index_;
};

}  // namespace matiere
