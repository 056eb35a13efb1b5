#include "base/student.h"

#include <algorithm>
#include <cmath>

namespace matiere {
namespace {

constexpr double kMostFreedom = 1e4;

double guarded(double x) { return std::abs(x) < 1e-300 ? 1e-300 : x; }

/// Continued fraction of the incomplete beta function, by the method of Lentz (1976).
double beta_fraction(double a, double b, double x) {
    double c = 1.0, d = 1.0 / guarded(1.0 - (a + b) * x / (a + 1.0)), h = d;
    for (int m = 1; m < 10'000; ++m) {
        const double even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m));
        d = 1.0 / guarded(1.0 + even * d);
        c = guarded(1.0 + even / c);
        h *= d * c;
        const double odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0));
        d = 1.0 / guarded(1.0 + odd * d);
        c = guarded(1.0 + odd / c);
        h *= d * c;
        if (std::abs(d * c - 1.0) < 1e-14) break;
    }
    return h;
}

/// Regularised incomplete beta function; y = 1 - x, given because it may be tiny.
double incomplete_beta(double a, double b, double x, double y) {
    if (x <= 0.0) return 0.0;
    if (y <= 0.0) return 1.0;
    const double log_front =
        std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b) + a * std::log(x) + b * std::log(y);
    const double front = std::exp(log_front);
    if (x < (a + 1.0) / (a + b + 2.0)) return front * beta_fraction(a, b, x) / a;
    return 1.0 - front * beta_fraction(b, a, y) / b;
}

}  // namespace

double student_tail(double t, double dof) {
    const double n = std::min(dof, kMostFreedom), square = t * t;
    return 0.5 * incomplete_beta(0.5 * n, 0.5, n / (n + square), square / (n + square));
}

double student_quantile(double tail, double dof) {
    double low = 0.0, high = 1.0;
    while (student_tail(high, dof) > tail && high < 1e150) high *= 2.0;
    for (int i = 0; i < 200 && high - low > 1e-12 * high; ++i) {
        const double middle = 0.5 * (low + high);
        (student_tail(middle, dof) > tail ? low : high) = middle;
    }
    return 0.5 * (low + high);
}

}  // namespace matiere
