#include "optics/facet_table.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "base/numeric.h"

namespace matiere {
namespace {

constexpr int kFine = 384;  // of each coordinate, to find quantiles
constexpr int kSub = 4;     // Gauss-Legendre points per side of a cell
constexpr std::array<double, kSub> kPoints{0.06943184420297371, 0.33000947820757187,
                                           0.66999052179242813, 0.93056815579702629};
constexpr std::array<double, kSub> kWeights{0.17392742256872693, 0.32607257743127307,
                                            0.32607257743127307, 0.17392742256872693};
constexpr int kAzimuthRows = 161;      // of the table of sigma, 0 and 2 pi both among them
constexpr double kEven = 0.25;         // share of the edges that is laid evenly
constexpr double kNegligible = 1e-10;  // share of the facets: far below the quadrature's error
constexpr double kEverywhere = 1e-3;   // of samples, so that no facet is impossible
constexpr double kTwoPiD = kTwoPi<double>;

Vec3d direction(double cos_theta, double phi) {
    const double s = std::sqrt(std::max((1.0 - cos_theta) * (1.0 + cos_theta), 0.0));
    return {s * std::cos(phi), s * std::sin(phi), cos_theta};
}

double azimuth(Vec3d w) {
    const double phi = std::atan2(w.y, w.x);
    return phi < 0.0 ? phi + kTwoPiD : phi;
}

/// Edges of n intervals of equal weight between the edges of a finer histogram, a share of the
/// weight laid evenly over the intervals of `base`.
std::vector<double> quantiles(const std::vector<double>& base, const std::vector<double>& weight,
                              int n) {
    double total = 0.0;
    for (const double w : weight) total += w;
    const double even = total > 0.0 ? kEven / double(weight.size()) : 1.0 / double(weight.size());
    const double scale = total > 0.0 ? (1.0 - kEven) / total : 0.0;
    std::vector<double> edges{base.front()};
    double sum = 0.0;
    for (std::size_t i = 0; i < weight.size(); ++i) {
        const double part = weight[i] * scale + even;
        while (int(edges.size()) < n && sum + part >= double(edges.size()) / n) {
            const double t = (double(edges.size()) / n - sum) / part;
            edges.push_back(base[i] + t * (base[i + 1] - base[i]));
        }
        sum += part;
    }
    edges.push_back(base.back());
    return edges;
}

/// Facets in columns, so that the sum over them runs in vector lanes.
struct Facets {
    static constexpr std::size_t kLanes = 16;
    std::vector<float> x, y, z;  // times area

    explicit Facets(const std::vector<FacetTable::Node>& nodes) {
        for (const auto& node : nodes) {
            x.push_back(float(node.h.x * node.area));
            y.push_back(float(node.h.y * node.area));
            z.push_back(float(node.h.z * node.area));
        }
        const std::size_t padded = (x.size() + kLanes - 1) / kLanes * kLanes;
        for (auto* column : {&x, &y, &z}) column->resize(padded, 0.0F);
    }

    double seen_from(Vec3d k) const {
        const auto kx = float(k.x), ky = float(k.y), kz = float(k.z);
        std::array<float, kLanes> sums{};
        for (std::size_t i = 0; i < x.size(); i += kLanes)
            for (std::size_t j = 0; j < kLanes; ++j)
                sums[j] += std::max(kx * x[i + j] + ky * y[i + j] + kz * z[i + j], 0.0F);
        double sum = 0.0;
        for (const float s : sums) sum += double(s);
        return sum;
    }
};

int interval(const std::vector<double>& edges, double x, bool falling) {
    const auto at = falling ? std::upper_bound(edges.begin(), edges.end(), x, std::greater<>())
                            : std::upper_bound(edges.begin(), edges.end(), x);
    return std::clamp(int(at - edges.begin()) - 1, 0, int(edges.size()) - 2);
}

}  // namespace

FacetTable::FacetTable(const FacetDensity& p, double narrow) {
    make_edges(p, narrow);
    std::vector<Node> nodes;
    std::vector<double> mass(kCells), solid(kCells);
    double total = 0.0;
    for (int cell = 0; cell < kCells; ++cell) {
        const std::size_t row = std::size_t(cell / kPhi), column = std::size_t(cell % kPhi);
        const double omega =
            (cos_edges_[row] - cos_edges_[row + 1]) * (phi_edges_[column + 1] - phi_edges_[column]);
        double peak = 0.0, sum = 0.0;
        for (std::size_t k = 0; k < kSub * kSub; ++k) {
            const std::size_t a = k / kSub, b = k % kSub;
            const Vec3d h = cell_direction(cell, kPoints[a], kPoints[b]);
            const double density = p(h);
            if (!(density > 0.0)) continue;
            const double area = density * omega * kWeights[a] * kWeights[b];
            nodes.push_back({h, area});
            sum += area;
            peak = std::max(peak, density * omega);
            projected_ += area * h.z;
        }
        // Halfway to the peak: weights stay small where p falls steeply inside a cell.
        mass[std::size_t(cell)] = 0.5 * (sum + peak);
        total += mass[std::size_t(cell)];
        solid[std::size_t(cell)] = omega / kTwoPiD;
    }
    if (!(projected_ > 0.0)) return;
    for (Node& node : nodes) node.area /= projected_;
    std::erase_if(nodes, [](const Node& node) { return node.area < kNegligible; });
    for (std::size_t c = 0; c < kCells; ++c) mass[c] += kEverywhere * total * solid[c];
    tabulate_sigma(nodes, narrow);
    tabulate_views(mass);
}

/// Fine cells even in log theta near the normal, down to a tenth of the narrowest width.
void FacetTable::make_edges(const FacetDensity& p, double narrow) {
    const double stretch = std::log1p(10.0 * kFine / std::max(narrow * kFine, 1.0));
    std::vector<double> theta(kFine + 1), cosine(kFine + 1), phi(kFine + 1);
    for (int i = 0; i <= kFine; ++i) {
        const double t = double(i) / kFine;
        theta[std::size_t(i)] = kPi<double> / 2 * std::expm1(t * stretch) / std::expm1(stretch);
        cosine[std::size_t(i)] = i == kFine ? 0.0 : std::cos(theta[std::size_t(i)]);
        phi[std::size_t(i)] = kTwoPiD * t;
    }
    std::vector<double> by_theta(kFine), by_phi(kFine);
    for (std::size_t i = 0; i < kFine; ++i)
        for (std::size_t j = 0; j < kFine; ++j) {
            const double middle = 0.5 * (theta[i] + theta[i + 1]);
            const Vec3d h = direction(std::cos(middle), 0.5 * (phi[j] + phi[j + 1]));
            const double m = p(h) * (cosine[i] - cosine[i + 1]);
            by_theta[i] += m;
            by_phi[j] += m;
        }
    const std::vector<double> edges = quantiles(theta, by_theta, kTheta);
    for (const double t : edges) cos_edges_.push_back(std::cos(t));
    cos_edges_.back() = 0.0;
    phi_edges_ = quantiles(phi, by_phi, kPhi);
}

void FacetTable::tabulate_sigma(const std::vector<Node>& nodes, double narrow) {
    const Facets facets(nodes);
    sigma_.ceiling = 1e6;  // slanted facets show more than the surface's own area
    for (int r = 0; r < kAzimuthRows; ++r) {
        sigma_.stretch.push_back(
            Stretch<double>::make(AlbedoTable<double>::cosine_scale(std::min(narrow, 1.0))));
        sigma_.average.emplace_back();
        const double phi = kTwoPiD * r / (kAzimuthRows - 1);
        for (int i = 0; i < AlbedoTable<double>::kNodes; ++i) {
            const Vec3d k = direction(sigma_.node_cosine(r, i), phi);
            sigma_.E.emplace_back(facets.seen_from(k));
        }
    }
}

void FacetTable::tabulate_views(const std::vector<double>& mass) {
    std::vector<Vec3d> middle(kCells);
    std::vector<double> radius(kCells);
    for (int c = 0; c < kCells; ++c) {
        middle[std::size_t(c)] = cell_direction(c, 0.5, 0.5);
        for (int k = 0; k < 4; ++k) {
            const Vec3d corner = cell_direction(c, k / 2, k % 2);
            radius[std::size_t(c)] =
                std::max(radius[std::size_t(c)],
                         std::acos(std::clamp(dot(corner, middle[std::size_t(c)]), -1.0, 1.0)));
        }
    }
    for (int v = 0; v < kViewTheta * kViewPhi; ++v) {
        const double theta0 = kPi<double> / 2 * (v / kViewPhi) / kViewTheta;
        const double step = kPi<double> / 2 / kViewTheta;
        const double phi = kTwoPiD * ((v % kViewPhi) + 0.5) / kViewPhi;
        const Vec3d centre = direction(std::cos(theta0 + step / 2), phi);
        const double reach = std::hypot(step / 2, std::sin(theta0 + step) * kPi<double> / kViewPhi);
        double total = 0.0;
        std::vector<double> sums{0.0};
        for (std::size_t c = 0; c < kCells; ++c) {
            const double away = std::acos(std::clamp(dot(centre, middle[c]), -1.0, 1.0));
            const double nearest = std::max(away - reach - radius[c], 0.0);
            total += nearest < kPi<double> / 2 ? mass[c] * std::cos(nearest) : 0.0;
            sums.push_back(total);
        }
        for (const double s : sums) cdf_.push_back(s / total);
    }
}

Vec3d FacetTable::cell_direction(int cell, double u, double v) const {
    const std::size_t row = std::size_t(cell / kPhi), column = std::size_t(cell % kPhi);
    return direction(lerp(u, cos_edges_[row], cos_edges_[row + 1]),
                     lerp(v, phi_edges_[column], phi_edges_[column + 1]));
}

int FacetTable::view(Vec3d o) const {
    const double theta = std::atan2(std::sqrt(o.x * o.x + o.y * o.y), o.z);
    const int row = std::clamp(int(theta / (kPi<double> / 2) * kViewTheta), 0, kViewTheta - 1);
    const int column = std::clamp(int(azimuth(o) / kTwoPiD * kViewPhi), 0, kViewPhi - 1);
    return row * kViewPhi + column;
}

double FacetTable::sigma(Vec3d k) const { return sigma_.lookup(k.z, azimuth(k) / kTwoPiD)[0]; }

double FacetTable::pdf(Vec3d o, Vec3d h) const {
    const std::size_t row = std::size_t(interval(cos_edges_, h.z, true));
    const std::size_t column = std::size_t(interval(phi_edges_, azimuth(h), false));
    const double omega =
        (cos_edges_[row] - cos_edges_[row + 1]) * (phi_edges_[column + 1] - phi_edges_[column]);
    const double* sums = cdf(view(o));
    const std::size_t cell = row * kPhi + column;
    return (sums[cell + 1] - sums[cell]) / omega;
}

Vec3d FacetTable::sample(Vec3d o, Vec3d u) const {
    const double* sums = cdf(view(o));
    const auto at = std::upper_bound(sums, sums + kCells + 1, u.x);
    const int cell = std::clamp(int(at - sums) - 1, 0, kCells - 1);
    return cell_direction(cell, u.y, u.z);
}

}  // namespace matiere
