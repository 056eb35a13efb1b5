// Student's t: tail probability and quantile, for any degrees of freedom.
#pragma once

namespace matiere {

/// P(T > t) for t >= 0, by the continued fraction of the incomplete beta function (Abramowitz &
/// Stegun 1964, 26.5.8 and 26.7.1).
double student_tail(double t, double dof);

/// t with P(T > t) = tail, 0 < tail < 0.5. Degrees of freedom above 10^4 count as 10^4, which is
/// the normal distribution to better than 0.1 %.
double student_quantile(double tail, double dof);

}  // namespace matiere
