// The environment: a lat-long radiance map at infinity, sampled where it exceeds its mean.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "base/spectrum.h"
#include "base/vec.h"
#include "light/map_sampler.h"
#include "light/portals.h"
#include "sampling/sampler.h"

namespace matiere {

/// What light is looked for.
struct Receiver {
    Vec3f p;
    Vec3f n{};  ///< unit, on the side that is lit; zero where light comes from all around
};

/// Row 0 is +y, the centre column looks along -z, u grows to the right seen from inside.
class EnvironmentLight {
 public:
    struct Sample {
        Vec3f wi;
        Spectrumf radiance;
        float pdf;  ///< per solid angle
    };

    /// `pixels` holds 3 floats a pixel, finite and >= 0; rotation about +y, right-handed.
    EnvironmentLight(int width, int height, std::vector<float> pixels, double rotation_deg,
                     double scale, Portals portals = {});

    /// Bilinear in u and v, wrapping in u.
    Spectrumf radiance(Vec3f direction) const;
    /// Density of `sample`, per solid angle; 0 where the map does not exceed its mean, and from a
    /// point that faces portals, beside them.
    float pdf(const Receiver& at, Vec3f direction) const;
    struct Seen {
        Spectrumf radiance;
        float pdf;  ///< per solid angle
    };
    /// Both of the above.
    Seen see(const Receiver& at, Vec3f direction) const;
    /// Nothing where the map is even or dark above the receiver, or what was picked lies beside all
    /// portals that are faced.
    std::optional<Sample> sample(const Receiver& at, const SampleBlock& u) const;
    /// Power over pi of the light that sampling is for, through a scene of this radius squared.
    double sampled_power(double disk) const;
    bool is_constant() const { return width_ == 1 && height_ == 1; }
    std::size_t bytes() const;

 private:
    struct Texel {
        float u, v;  ///< continuous coordinates in [0, width) x [0, height]
    };
    int table(const Receiver& at) const;
    float map_pdf(int table, Texel t) const;
    float map_pdf(const Receiver& at, Vec3f direction) const {
        return map_.empty() ? 0 : map_pdf(table(at), to_texel(direction));
    }
    std::optional<Sample> sample_map(const Receiver& at, const SampleBlock& u) const;
    /// How often a direction is picked through a portal rather than by the map.
    float portal_share(Vec3f reference) const;

    Texel to_texel(Vec3f direction) const;
    Vec3f from_angles(float sin_theta, float cos_theta, float phi) const;
    Spectrumf pixel(int x, int y) const;
    Spectrumf lookup(Texel t) const;
    std::vector<double> cell_means() const;
    void build_distribution();

    int width_, height_;
    std::vector<float> pixels_;
    float cos_rotation_, sin_rotation_;
    Portals portals_;
    double sampled_luminance_ = 0;  ///< mean over the sphere of what exceeds the mean
    double mean_luminance_ = 0;
    std::vector<double> cos_edge_;  ///< cosine of theta at the row edges
    MapSampler map_;
};

}  // namespace matiere
