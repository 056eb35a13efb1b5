#include "material/material.h"

#include <algorithm>
#include <cmath>
#include <variant>

#include "base/error.h"

namespace matiere {
namespace {

/// Shading normals that would face away from the viewer are bent until wo is just above their
/// horizon; 1e-3 keeps the black rim of coarse meshes away and cosines out of the denormals.
constexpr float kMinShadingCosine = 1e-3F;

Vec3f bend_towards(Vec3f n_s, Vec3f wo, Vec3f n_g) {
    const float target = std::min(kMinShadingCosine, dot(wo, n_g));
    const float c = dot(wo, n_s);
    if (c >= target) return n_s;
    const Vec3f tangential = n_s - wo * c;
    const float l2 = length_squared(tangential);
    if (!(l2 > 1e-8F)) return n_g;
    return tangential * std::sqrt((1.0F - target * target) / l2) + wo * target;
}

void read_emission(const MaterialDescription& d, const TextureTable& textures, MaterialRecord& r) {
    const std::string pointer = d.pointer + "/emission";
    if (const auto* number = std::get_if<double>(&d.emission)) {
        r.emission = Spectrumf(float(*number));
    } else if (const auto* rgb = std::get_if<std::array<double, 3>>(&d.emission)) {
        r.emission = {float((*rgb)[0]), float((*rgb)[1]), float((*rgb)[2])};
    } else if (const auto* ref = std::get_if<TextureRef>(&d.emission)) {
        if (ref->index < 0 || ref->index >= textures.size())
            throw SceneError("unknown_texture", "emission names a texture that does not exist",
                             pointer);
        const ImageTexture& image = textures[ref->index];
        if (image.minimum().has_negative())
            throw SceneError("out_of_range", "emission must not be negative", pointer);
        r.emission_texture = ref->index;
        r.emission = image.mean();
    } else {
        throw SceneError("wrong_type", "emission must be a number, [r, g, b] or a texture",
                         pointer);
    }
    if (!r.emission.is_finite() || r.emission.has_negative())
        throw SceneError("out_of_range", "emission must be finite and not negative", pointer);
    r.emissive = !r.emission.is_black();
}

MaterialRecord make_record(const MaterialDescription& d, const TextureTable& textures,
                           TableStore<float>& tables) {
    MaterialRecord r;
    r.recipe = make_recipe<float>(d, textures, tables);
    r.two_sided = d.two_sided;
    r.priority = d.priority;
    read_emission(d, textures, r);
    visit_model(r.recipe.model, [&]<class M>(const M& m) {
        if constexpr (!std::same_as<M, std::monostate>) {
            r.features = M::kFeatures;
            r.lobes = m.lobes();
        }
        // Only a lobe that is wider one way needs the tangent.
        if constexpr (requires { m.is_anisotropic(); })
            if (!r.recipe.textured() && !m.is_anisotropic())
                r.features &= ~std::uint32_t(kFeatureAnisotropic);
        if constexpr (InterfaceModel<M, float>) {
            r.has_interior = true;
            r.eta_interior = m.interior().eta;
            r.sigma_a = m.interior().sigma_a;
        }
    });
    r.delta_only = (r.lobes & (kDiffuse | kGlossy)) == 0;
    if (r.recipe.textured()) r.features |= kFeatureTextured;
    if (r.emissive) r.features |= kFeatureEmission;
    return r;
}

}  // namespace

MaterialTable::MaterialTable(const std::vector<MaterialDescription>& descriptions,
                             const TextureTable& textures)
    : textures_(&textures), tables_(std::make_unique<TableStore<float>>()) {
    records_.reserve(descriptions.size());
    for (const auto& d : descriptions) records_.push_back(make_record(d, textures, *tables_));
}

Spectrumf MaterialTable::emission(int material, Vec2f uv) const {
    const MaterialRecord& r = (*this)[material];
    return r.emission_texture < 0 ? r.emission : (*textures_)[r.emission_texture].lookup(uv);
}

Bsdf::Bsdf(const MaterialTable& table, int material, const SurfacePoint& point, Vec3f wo,
           float eta_rel)
    : n_g_(point.n_g), material_(material) {
    const MaterialRecord& record = table[material];
    const bool interface = (record.features & kFeatureTransmission) != 0;
    Vec3f n_s = point.n_s;
    if (dot(wo, n_g_) < 0.0F) {
        n_g_ = -n_g_;
        n_s = -n_s;
        black_ = !record.two_sided && !interface;
    }
    n_s = bend_towards(n_s, wo, n_g_);
    frame_ = (record.features & kFeatureAnisotropic) ? Framef::from_normal_tangent(n_s, point.dpdu)
                                                     : Framef::from_normal(n_s);
    if (record.recipe.textured())
        own_ = record.recipe.at(table.textures(), point.uv);
    else
        constant_ = &record.recipe.model;
    if (!interface) return;
    visit_model(model(), [&]<class M>(const M& m) {
        if constexpr (InterfaceModel<M, float>) {
            const M met = m.at_interface(eta_rel);
            own_ = met;
            constant_ = nullptr;
        }
    });
}

BsdfEval<float> Bsdf::eval(Vec3f wo, Vec3f wi) const {
    const Vec3f local_o = frame_.to_local(wo);
    const Vec3f local_i = frame_.to_local(wi);
    const float side = dot(wi, n_g_);
    if (black_ || !(local_o.z > 0.0F) || !(local_i.z * side > 0.0F)) return {};
    return visit_model(model(), [&]<class M>(const M& m) -> BsdfEval<float> {
        if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return m.eval(local_o, local_i);
    });
}

BsdfEval<float> Bsdf::eval(Vec3f wo, Vec3f wi, Counters& counters) const {
    const BsdfEval<float> e = eval(wo, wi);
    if (e.f.is_finite() && std::isfinite(e.pdf)) return e;
    counters.reject(Reject::kNonFiniteEval, material_);
    return {};
}

std::optional<BsdfSample<float>> Bsdf::sample(Vec3f wo, Vec3f u, Counters& counters) const {
    const Vec3f local_o = frame_.to_local(wo);
    if (black_ || !(local_o.z > 0.0F)) return {};
    auto s = visit_model(model(), [&]<class M>(const M& m) -> std::optional<BsdfSample<float>> {
        if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return m.sample(local_o, u);
    });
    if (!s) return {};
    if (!s->weight.is_finite() || !std::isfinite(s->pdf) || !is_finite(s->wi)) {
        counters.reject(Reject::kNonFiniteSample, material_);
        return {};
    }
    if (s->weight.is_black() || !(s->pdf > 0.0F)) return {};
    // A direction above the shading horizon but below the surface (or the reverse) is absorbed, as
    // eval says; the surface would shadow it.
    const float local_z = s->wi.z;
    s->wi = frame_.to_world(s->wi);
    if (!(local_z * dot(s->wi, n_g_) > 0.0F)) {
        counters.reject(Reject::kSideMismatch, material_);
        return {};
    }
    return s;
}

std::uint8_t Bsdf::lobes() const {
    if (black_) return 0;
    return visit_model(model(), []<class M>(const M& m) -> std::uint8_t {
        if constexpr (std::same_as<M, std::monostate>)
            return 0;
        else
            return m.lobes();
    });
}

}  // namespace matiere
