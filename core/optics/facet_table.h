// Facets of any distribution p(h) (Ashikhmin, Premoze, Shirley 2000, "A Microfacet-based BRDF
// Generator"): their visible area g(k) by quadrature, and a sampler of facets that a viewer sees.
//
// D = p / <hn> with <hn> the integral of p cos, so that the projected facet area is 1, and
// sigma(k) = g(k) / <hn> = integral of D max(k.h, 0). Densities are constant over cells of (theta,
// phi) whose edges follow the quantiles of p; every cell of view directions has its own cumulative
// distribution, of p times the most that any of its views sees of the facet cell.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "base/vec.h"
#include "optics/directional_albedo.h"

namespace matiere {

/// Relative density of facets of normal h (h.z > 0), any scale.
using FacetDensity = std::function<double(Vec3d)>;

class FacetTable {
 public:
    /// `narrow`: the smallest width of p, in radians.
    FacetTable(const FacetDensity& p, double narrow);

    /// What p is divided by to make D: the integral of p cos; 0 where there are no facets.
    double projected() const { return projected_; }
    /// Projected area of the facets that k (k.z > 0) sees.
    double sigma(Vec3d k) const;
    /// Density of sample() per solid angle of h.
    double pdf(Vec3d o, Vec3d h) const;
    Vec3d sample(Vec3d o, Vec3d u) const;

    struct Node {
        Vec3d h;
        double area = 0.0;  ///< D times solid angle
    };

 private:
    static constexpr int kTheta = 64, kPhi = 64, kCells = kTheta * kPhi;
    static constexpr int kViewTheta = 16, kViewPhi = 24;

    void make_edges(const FacetDensity& p, double narrow);
    void tabulate_sigma(const std::vector<Node>& nodes, double narrow);
    void tabulate_views(const std::vector<double>& mass);
    Vec3d cell_direction(int cell, double u, double v) const;
    int view(Vec3d o) const;
    const double* cdf(int view) const { return &cdf_[std::size_t(view) * (kCells + 1)]; }

    double projected_ = 0.0;
    AlbedoTable<double> sigma_;      ///< rows over azimuth, lane 0
    std::vector<double> cos_edges_;  ///< from 1 down to 0
    std::vector<double> phi_edges_;  ///< from 0 to 2 pi
    std::vector<double> cdf_;        ///< [view][cell]
};

}  // namespace matiere
