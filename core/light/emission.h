// Light leaving its source towards a ball: the start of paths from the lights. Nothing that misses
// the ball is sent, so that small things far from a light get as many paths as large ones.
#pragma once

#include <optional>

#include "light/light.h"

namespace matiere {

/// What paths are sent to.
struct Ball {
    Vec3f center;
    float radius = 0;
};

struct Emission {
    Vec3f p, direction;     ///< where light leaves, or enters the ball; unit, where it travels
    Vec3f error, n;         ///< of a surface that it leaves; zero of a point
    bool infinite = false;  ///< from infinity: p lies beside the ball, what is behind it may shade
    Spectrumf flux;         ///< over the density [W]
};

/// One start; nothing where the light does not shine that way. `place` chooses the point of a light
/// with a surface, `u` the direction.
std::optional<Emission> emit(const LightSet& lights, const MaterialTable& materials, int light,
                             const Ball& ball, const SampleBlock& place, Vec2f u);

/// Flux that `emit` sends in the mean, roughly: to weigh lights and balls against each other.
double expected_flux(const LightSet& lights, const MaterialTable& materials, int light,
                     const Ball& ball);

/// The sphere around a light, and its area; radius 0 where it is a point. Nothing at infinity.
struct LightBall {
    Ball ball;
    double area = 0;
};
std::optional<LightBall> light_ball(const LightSet& lights, int light);

}  // namespace matiere
