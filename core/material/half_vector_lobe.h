// A reflecting lobe that is sampled through its half vector: the frame of the models from before
// visible normals (Blinn-Phong, Ashikhmin-Shirley, Ward, Schlick). A Shape says how half vectors
// are drawn and what a reflection weighs:
//
//   pdf(wi) = p_h(h) / (4 o.h),   f cos = F(o.h) weight(o, i, h) p_h(h) / (4 o.h)
//
// Some shapes draw a share of the directions with cosine density, where the half vector's is far
// from the lobe. What is reflected below the horizon is lost, in sample and in pdf alike.
#pragma once

#include <optional>

#include "material/bsdf.h"
#include "material/half_vector.h"
#include "optics/fresnel_term.h"
#include "optics/microfacet.h"
#include "optics/quadrature.h"
#include "sampling/warp.h"

namespace matiere {

template <class R, class Shape>
struct HalfVectorLobe {
    Shape shape;
    FresnelTerm<R> fresnel;

    bool is_delta() const { return shape.is_delta(); }
    std::uint8_t lobe() const {
        return std::uint8_t((is_delta() ? kSpecular : kGlossy) | kReflection);
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (is_delta() || !(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        const R reflected = shape.density(half.h) / (R(4) * half.oh);
        const R weight = shape.weight(wo, wi, half);
        return {fresnel(half.oh, half.versed) * (reflected * weight), mixed_pdf(reflected, wi)};
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (is_delta()) {
            const Vec3<R> wi{-wo.x, -wo.y, wo.z};
            const R weight = shape.weight(wo, wi, {{R(0), R(0), R(1)}, wo.z, R(1) - wo.z});
            return BsdfSample<R>{wi, fresnel(wo.z) * weight, R(1), lobe()};
        }
        if (u.x < shape.cosine_share()) return sample_cosine(wo, u);
        const Vec3<R> h = shape.sample(u.y, u.z);
        const R oh = dot(wo, h);
        if (!(oh > R(0))) return {};
        const Vec3<R> wi = reflect(wo, h);
        if (!(wi.z > R(0))) return {};
        const HalfVector<R> half{h, oh, HalfVector<R>::versed_between(wo, wi, oh)};
        const R reflected = shape.density(h) / (R(4) * oh);
        const R pdf = mixed_pdf(reflected, wi);
        if (!(pdf > R(0))) return {};
        const R weight = shape.weight(wo, wi, half) * (reflected / pdf);
        return BsdfSample<R>{wi, fresnel(oh, half.versed) * weight, pdf, lobe()};
    }

 private:
    R mixed_pdf(R reflected, Vec3<R> wi) const {
        const R share = shape.cosine_share();
        if (!(share > R(0))) return reflected;
        return share * cosine_hemisphere_pdf(wi.z) + (R(1) - share) * reflected;
    }

    std::optional<BsdfSample<R>> sample_cosine(Vec3<R> wo, Vec3<R> u) const {
        const Vec3<R> wi = square_to_cosine_hemisphere(u.y, u.z);
        const BsdfEval<R> e = eval(wo, wi);
        if (!(e.pdf > R(0))) return {};
        return BsdfSample<R>{wi, e.f * (R(1) / e.pdf), e.pdf, lobe()};
    }
};

/// Directional albedo of a shape for the three terms of a linear Fresnel term. For each azimuth of
/// h the reflected direction is above the horizon up to a polar angle that is known, and higher
/// than wo up to another, so that the integrand is smooth in between: Gauss-Legendre nodes in the
/// share of half vectors within an angle. At grazing all changes where h turns its back on wo, so
/// that is where the azimuths gather.
template <class Shape>
class HalfVectorAlbedo {
 public:
    HalfVectorAlbedo(const Shape& shape, Vec3d wo) : shape_(shape), wo_(wo) {}

    Spectrumd operator()() const {
        static const TanhSinh azimuths(40);
        const double across = shape_.azimuth_variate({wo_.y, -wo_.x});
        Spectrumd sum;
        for (int half = 0; half < 2; ++half)
            for (std::size_t j = 0; j < azimuths.x.size(); ++j) {
                const double u = across + 0.5 * (half + azimuths.x[j]);
                sum += sector(shape_.azimuth(u - std::floor(u))) * (0.5 * azimuths.w[j]);
            }
        return sum;
    }

 private:
    const Shape& shape_;
    Vec3d wo_;

    Spectrumd sector(Vec2<double> phi) const {
        const double along = wo_.x * phi.x + wo_.y * phi.y;
        // i.z = along sin(2 theta) + o.z cos(2 theta), theta the polar angle of h.
        const double level = std::atan2(along, wo_.z);
        const double horizon = kPi<double> / 4 + level / 2;
        const double all = shape_.share_within(phi, horizon);
        if (!(level > 0.0)) return panel(phi, 0.0, all);
        const double middle = std::min(shape_.share_within(phi, level), all);
        return panel(phi, 0.0, middle) + panel(phi, middle, all);
    }

    Spectrumd panel(Vec2<double> phi, double from, double to) const {
        static const GaussLegendre nodes(16);
        Spectrumd sum;
        for (std::size_t k = 0; k < nodes.x.size(); ++k) {
            const Vec3d h = shape_.half_vector(phi, from + (to - from) * nodes.x[k]);
            const double oh = dot(wo_, h);
            const Vec3d wi = reflect(wo_, h);
            if (!(oh > 0.0) || !(wi.z > 0.0)) continue;
            sum += FresnelTerm<double>::terms(oh) *
                   (shape_.weight(wo_, wi, {h, oh, 1.0 - oh}) * (to - from) * nodes.w[k]);
        }
        return sum;
    }
};

template <class Shape>
Spectrumd half_vector_albedo(const Shape& shape, Vec3d wo) {
    return HalfVectorAlbedo<Shape>(shape, wo)();
}

}  // namespace matiere
