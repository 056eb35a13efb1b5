// How a luminaire spreads its light over directions: a table over the angle from its axis and the
// angle about it, read bilinearly (type C photometry of ANSI/IESNA LM-63).
#pragma once

#include <vector>

#include "base/vec.h"

namespace matiere {

class LightProfile {
 public:
    /// Angles ascend, in degrees; vertical ones lie in 0 to 180, horizontal ones go from 0 to 360,
    /// or are one. `values` has a row of vertical angles for each horizontal one.
    LightProfile(std::vector<float> vertical_deg, std::vector<float> horizontal_deg,
                 std::vector<float> values);

    /// `vertical` and `horizontal` in degrees; 0 beyond the vertical angles of the table.
    float value(float vertical, float horizontal) const;
    /// Integral of the value over the directions within the cosine of a cone about the axis.
    double flux(double cos_outer) const;

 private:
    std::vector<float> vertical_, horizontal_, values_;
};

/// Where a luminaire points: the axis (vertical angle 0) and the directions of the horizontal
/// angles 0 and 90.
struct ProfileFrame {
    Vec3f axis, zero, quarter;

    /// The frame of a luminaire that hangs, axis down, 0 towards +x and 90 towards -z, is turned by
    /// the shortest way to `axis`, then about it by `rotation_deg`, towards rising angles.
    static ProfileFrame hung(Vec3f axis, double rotation_deg);

    float value(const LightProfile& profile, Vec3f away) const;
};

}  // namespace matiere
