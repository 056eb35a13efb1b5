// What one more sample is worth in a strip: the root of its relative variance over its cost.
#pragma once

#include <cstdint>

namespace matiere {

class Film;

/// 0.01 m^2 with m the log-average luminance of S in one half of an adaptive film: the floor of the
/// weights 1 / (S^2 + 0.01 m^2).
double half_floor(const Film& film, int half);

/// sqrt(V / C): V is the sum over pixels and channels of the weighted variance of one sample of
/// this half, C the rays per sample. Samples in proportion to it make the relMSE of an image least
/// for its rays (Neyman 1934). S is taken inside the tile, without the pixel itself.
double strip_worth(const Film& film, int strip, double floor, std::uint64_t rays);

}  // namespace matiere
