// The error of a film, from its replicates alone: no reference image.
//
// Replicate means m_r are independent and alike. With x_r = m_r - mu and I = mean of m_r, the
// realised squared error of a pixel is xbar^2 and its unbiased estimate is e = s^2 / R. Their
// difference is the U-statistic D = sum_{i != j} x_i x_j / (R (R - 1)), of mean 0 and variance
// 2 sigma^4 / (R (R - 1)) whatever the kurtosis (Hoeffding 1948). Pixels are scrambled
// independently, so the variances of D add up over pixels and give the prediction interval for the
// realised error of this very image. Derivation and checks: docs/error.md.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "film/film.h"

namespace matiere {

inline constexpr double kConfidence = 0.95;  ///< of every interval unless another is named

struct ErrorEstimate {
    bool known = false;             ///< false: every other error below is meaningless
    double relmse = 0.0;            ///< mean over pixels and channels of var(I) / (S^2 + 0.01 m^2)
    double rmse = 0.0;              ///< root of the mean var(I), in units of radiance
    double rmse_percent = 0.0;      ///< 100 rmse / mean of I over pixels and channels
    double relmse_classic = 0.0;    ///< mean of var(I) / (I^2 + 0.01): against peers only
    double log_average = 0.0;       ///< m: log-average luminance of the non-zero pixels of S
    double unknown_share = 1.0;     ///< share of pixels whose replicates all agree exactly
    std::uint64_t look = 0;         ///< number of this look in its run, from 1: Plan::look_number
    double log_deviation = 0.0;     ///< standard deviation of log(realised / estimated relMSE)
    double effective_pixels = 0.0;  ///< (sum V)^2 / sum V^2 over the pixels' variances of D
    double least_freedom = 3.0;     ///< of Student's t: one pixel alone still has its replicates
    double rmse_log_deviation = 0.0;  ///< the same two for rmse_percent
    double rmse_effective_pixels = 0.0;
    std::array<double, 3> mean{};                 ///< of I
    std::array<double, 3> mean_standard_error{};  ///< of that mean
};

struct Interval {
    double lower = 0.0, upper = 0.0;
};

/// Prediction interval of the realised figure: this very image's error lies inside in `confidence`
/// of all renders.
Interval relmse_interval(const ErrorEstimate& e, double confidence = kConfidence);
Interval rmse_percent_interval(const ErrorEstimate& e, double confidence = kConfidence);

/// Confidence of look k of a run, 1 - 0.05 / (k (k + 1)): the misses of all looks together sum to
/// 5 %, so intervals at this confidence hold at every look at once (Bonferroni 1936).
double look_confidence(std::uint64_t look);

inline constexpr double kRelativeFloor = 0.01;  ///< of m^2, keeps black pixels finite
inline constexpr double kClassicFloor = 0.01;   ///< of the classic relMSE, in squared radiance
inline constexpr int kColorChannels = 3;

ErrorEstimate estimate_error(const Film& film);

/// The pixels [x0, x1) x [y0, y1) and their error, relative to the m of the whole film.
struct TileEstimate {
    int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
    ErrorEstimate error;
};

/// The error of every square of `edge` pixels, row by row.
std::vector<TileEstimate> estimate_tiles(const Film& film, int edge);

/// 1 / (S^2 + 0.01 m^2) of every pixel and channel, [y][x][channel], S from all replicates: the
/// weights by which a reference measures the realised relMSE of another film.
std::vector<double> error_weights(const Film& film);

/// Unbiased variance of the pixel mean, [y][x][channel], from the pixel's own R - 1 degrees of
/// freedom; NaN where there is no sample or R = 1.
std::vector<double> mean_variance(const Film& film);

/// Standard error of the pixel mean, [y][x][channel]: root of mean_variance averaged over 5 x 5
/// pixels (about 25 (R - 1) degrees of freedom); NaN where nothing is known, never zero.
std::vector<double> standard_error(const Film& film);

}  // namespace matiere
