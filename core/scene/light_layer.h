// Which light is found by paths from the lights instead of paths from the camera: that of small
// lights by way of mirrors and lenses, as far as the camera sees it on a surface that is neither.
//
// Paths are parted by class, so that nothing counts twice and no weights are needed. With the
// scattering events of a path counted from the camera, the layer owns it if
//   - its first event is wide: no delta, nor a lobe of a material that `sharp` calls one,
//   - its last event is sharp: a delta, or of such a material,
//   - and `owns` its light.
// Both sides ask here, vertex by vertex, and nothing else decides.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "accel/embree_scene.h"
#include "light/emission.h"
#include "sampling/discrete.h"
#include "scene/interior.h"

namespace matiere {

class Scene;

class LightLayer {
 public:
    /// No need: the camera's paths find everything, or paths from the lights could find nothing.
    LightLayer() = default;
    /// `hard` counts by light the photons that camera paths would hardly find: without `all`, lamps
    /// with a surface take part only if they are small and have such photons. Points and directions
    /// always do: no camera path can find what they send by way of a delta.
    LightLayer(const Scene& scene, std::span<const std::uint32_t> hard, bool all);

    bool empty() const { return choice_.empty(); }
    bool owns(int light) const {
        return light >= 0 && std::size_t(light) < owned_.size() && owned_[std::size_t(light)] != 0;
    }
    /// Whether what a material scatters without being a delta counts as sharp.
    bool sharp(int material) const { return sharp_[std::size_t(material)] != 0; }
    /// Whether its values are estimates of a random walk, with a density that stands in.
    bool is_estimate(int material) const { return estimate_[std::size_t(material)] != 0; }
    /// Whether paths from the lights may be seen on a material.
    bool receives(int material) const { return receives_[std::size_t(material)] != 0; }

    /// A light and the sharp thing that a path is sent to.
    struct Pair {
        int light;
        std::uint32_t target;
        float probability;
    };
    Pair choose(std::uint32_t u) const;
    const Ball& ball(std::uint32_t target) const { return targets_[target].ball; }
    /// Whether a hit is on the target of a path: its first event must be there.
    bool is_target(std::uint32_t target, const RayHit& hit, int material) const;
    /// The media where a path starts.
    InteriorStack media(const Scene& scene, int light, const Emission& start) const;

    int lights() const { return owned_count_; }
    std::size_t targets() const { return targets_.size(); }

 private:
    /// A mesh or a sphere that is sharp; or everything sharp, where there are too many pairs.
    struct Target {
        Ball ball;
        std::uint32_t geometry = RayHit::kMiss, primitive = 0;
        bool is_sphere = false;
    };
    /// Where the media around a light come from.
    enum class Media : std::uint8_t { kNone, kFixed, kAtStart };

    void classify(const Scene& scene);
    void find_targets(const Scene& scene);
    void choose_lights(const Scene& scene, std::span<const std::uint32_t> hard, bool all);
    void weigh_pairs(const Scene& scene);
    void find_media(const Scene& scene);
    bool is_small(const LightBall& light) const;
    bool any_target_beside(std::span<const Ball> interiors) const;

    std::vector<std::uint8_t> sharp_, reflects_sharply_, estimate_, receives_;  // by material
    std::vector<std::uint8_t> owned_;                                           // by light
    int owned_count_ = 0;
    std::vector<Target> targets_;
    std::vector<int> lights_;  // owned ones, by index in pairs: light-major
    DiscreteDistribution choice_;
    std::vector<Media> media_;  // by light
    std::vector<InteriorStack> fixed_;
};

}  // namespace matiere
