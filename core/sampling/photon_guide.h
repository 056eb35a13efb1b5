// Where hard light comes from: directions learnt from photons that went through mirrors and lenses
// before they landed, as an extra way to choose directions at the places where they landed.
// Sources: Jensen 1995 (importance from photons); Hey & Purgathofer 2002 (one cone per photon);
// Rath et al. 2020 and Ruppert et al. 2020 (directions corrected for parallax).
#pragma once

#include <cstdint>
#include <vector>

#include "base/vec.h"

namespace matiere {

struct GuidePhoton {
    Vec3f p;           ///< where it landed
    Vec3f from;        ///< where it last left a surface
    float weight = 0;  ///< flux [W]

    friend bool operator==(const GuidePhoton&, const GuidePhoton&) = default;
};

/// A k-d tree over the landing points; each leaf is one region of few photons.
class PhotonGuide {
 public:
    /// What is known about the hard light around one point: a mixture of round lobes, one per
    /// photon.
    class Region {
     public:
        /// Share of directions to take from `sample`, in (0, 1).
        float share() const { return share_; }
        /// A unit direction at p; `choice` picks the photon, `u` the direction around it.
        Vec3f sample(Vec3f p, float choice, Vec2f u) const;
        /// Density of `sample` per solid angle.
        float pdf(Vec3f p, Vec3f wi) const;

     private:
        friend class PhotonGuide;
        struct Lobe {
            Vec3f anchor;          ///< a point, or the direction itself at infinity
            float cumulative = 0;  ///< of the weights in the region, 1 at the last
        };
        Vec3f axis(Vec3f p, const Lobe& lobe) const;

        Vec3f low_, high_;
        const Lobe* lobes_ = nullptr;
        std::uint32_t count_ = 0;
        float sign_ = 1;  ///< of the way from p to an anchor; 0: anchors are directions
        float spread_ = 1, share_ = 0;
    };

    PhotonGuide() = default;
    PhotonGuide(PhotonGuide&&) = default;
    PhotonGuide& operator=(PhotonGuide&&) = default;
    /// `ordinary` is the irradiance of the light that needs no guide [W/m^2].
    PhotonGuide(std::vector<GuidePhoton> photons, double ordinary);

    bool empty() const { return regions_.empty(); }
    std::size_t photons() const { return lobes_.size(); }
    std::size_t bytes() const;
    /// The region that holds p; null where no hard light is known.
    const Region* find(Vec3f p) const;

 private:
    struct Node {
        float split = 0;
        std::uint32_t axis = 0;   ///< 3: a leaf
        std::uint32_t child = 0;  ///< the right child, or the region of a leaf
    };
    void build(std::vector<GuidePhoton>& photons, std::size_t begin, std::size_t end);
    void add_region(const std::vector<GuidePhoton>& photons, std::size_t begin, std::size_t end);

    std::vector<Node> nodes_;
    std::vector<Region> regions_;
    std::vector<Region::Lobe> lobes_;
    double ordinary_ = 0;
};

}  // namespace matiere
