// Windows that the environment's light comes through: rectangles sampled by area from where they
// are faced, instead of the whole sphere of directions.
#pragma once

#include <optional>
#include <vector>

#include "light/area.h"

namespace matiere {

class Portals {
 public:
    struct Sample {
        Vec3f wi;
        float pdf;  ///< per solid angle, of all portals together
    };

    Portals() = default;
    explicit Portals(std::vector<RectangleShape> shapes) : shapes_(std::move(shapes)) {}

    bool empty() const { return shapes_.empty(); }
    double area() const {
        double sum = 0;
        for (const RectangleShape& s : shapes_) sum += double(s.area);
        return sum;
    }

    /// Portals whose front the point sees; the others give it no light.
    int faced(Vec3f reference) const {
        int n = 0;
        for (const RectangleShape& s : shapes_) n += faces(s, reference) ? 1 : 0;
        return n;
    }
    /// A direction through one of them, each as likely; `u` lies in [0, 1).
    std::optional<Sample> sample(Vec3f reference, float u, const SampleBlock& block) const;
    /// Density of `sample`; 0 beside all of them.
    float pdf(Vec3f reference, Vec3f direction) const;

 private:
    static bool faces(const RectangleShape& s, Vec3f reference) {
        return dot(reference - s.corner, s.n) > 0;
    }

    std::vector<RectangleShape> shapes_;
};

}  // namespace matiere
