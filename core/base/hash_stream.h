// Random numbers for estimates inside one material evaluation: a pure function of the directions
// asked for, so that a render stays a pure function of its seed.
#pragma once

#include <bit>
#include <cstdint>
#include <type_traits>

#include "base/rng.h"
#include "base/vec.h"

namespace matiere {

template <class R>
class HashStream {
 public:
    HashStream(Vec3<R> a, Vec3<R> b, std::uint64_t purpose)
        : key_(hash_words(purpose, bits(a.x), bits(a.y), bits(a.z), bits(b.x), bits(b.y),
                          bits(b.z))) {}

    R next() { return R(unit_float(std::uint32_t(mix64(key_ + ++count_ * kStep) >> 32U))); }
    Vec3<R> next3() {
        const R x = next(), y = next();
        return {x, y, next()};
    }

 private:
    static constexpr std::uint64_t kStep = 0x9e3779b97f4a7c15ULL;
    static std::uint64_t bits(R x) {
        using Word = std::conditional_t<sizeof(R) == 4, std::uint32_t, std::uint64_t>;
        return std::bit_cast<Word>(x);
    }

    std::uint64_t key_;
    std::uint64_t count_ = 0;
};

}  // namespace matiere
