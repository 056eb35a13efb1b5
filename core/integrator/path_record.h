// What one path met, vertex by vertex: written by the recording kernel alone.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "base/spectrum.h"
#include "base/vec.h"
#include "integrator/integrator.h"

namespace matiere {

/// Light that reached a path, or would have.
struct LightMeeting {
    std::string_view how;  ///< "light": looked for; "bsdf": met by a sampled direction; "camera"
    int light = -1;        ///< index in the scene's lights; -1 where the direction met none
    Vec3f direction;       ///< towards the light
    float pdf_light = 0;   ///< of light sampling per solid angle; 0: it cannot find this
    float pdf_bsdf = 0;    ///< of the other technique
    float mis_weight = 1;
    Spectrumf contribution;  ///< to the pixel's sample, as it was added
    bool blocked = false;    ///< a light sample that nothing arrived from
};

struct PathVertex {
    std::string_view event;  ///< "scatter", "pass", "hidden", "end"
    Vec3f p, n_g, n_s;
    float distance = 0;     ///< from the last vertex [m]
    int material = -1;      ///< -1: a light that does not scatter
    int light = -1;         ///< the light that the surface is, if any
    int medium = -1;        ///< material whose inside the path came through; -1: none
    bool outside = true;    ///< met on the outside of its shape
    Spectrumf throughput;   ///< on arrival, with the absorption on the way
    std::uint8_t lobe = 0;  ///< Lobe bits of the sampled event
    float pdf = 0;          ///< of the sampled direction; of the lobe where it is a delta
    bool guided = false;    ///< directions of hidden light took part
    Spectrumf weight;       ///< f cos / pdf of the sampled direction
    float eta = 1;          ///< transmitted over incident index of the event
    float survival = 1;     ///< probability with which roulette let it go on
    int lane = -1;          ///< the one lane of a dispersed path
    std::vector<LightMeeting> lights;
};

struct PathRecord {
    Vec3f origin, direction;
    std::vector<PathVertex> vertices;
    std::vector<LightMeeting> background;  ///< light of the environment where the path left
    std::string_view
        end;  ///< escaped, emitter, absorbed, max_depth, threshold, roulette, black, depth_guard
    PathResult result;
};

/// One sample again, by the recording kernel: its result has the bits of any other kernel.
PathRecord record_path(const Scene& scene, const PathSettings& settings, const SampleId& id);

}  // namespace matiere
