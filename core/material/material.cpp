#include "material/material.h"

#include <algorithm>
#include <cmath>
#include <variant>

#include "base/error.h"
#include "material/normal_map.h"

namespace matiere {
namespace {

/// Shading normals that would face away from the viewer are bent until wo is just above their
/// horizon; 1e-3 keeps the black rim of coarse meshes away and cosines out of the denormals.
constexpr float kMinShadingCosine = 1e-3F;
constexpr std::uint8_t kNullLobes = kSpecular | kTransmission | kNull;

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

void read_opacity(const MaterialDescription& d, const TextureTable& textures, MaterialRecord& r) {
    const std::string pointer = d.pointer + "/opacity";
    float low = 1, high = 1;
    if (const auto* number = std::get_if<double>(&d.opacity)) {
        low = high = r.opacity = float(*number);
    } else if (const auto* ref = std::get_if<TextureRef>(&d.opacity)) {
        if (ref->index < 0 || ref->index >= textures.size())
            throw SceneError("unknown_texture", "opacity names a texture that does not exist",
                             pointer);
        const ImageTexture& image = textures[ref->index];
        low = image.minimum()[0];
        high = image.maximum()[0];
        r.opacity_texture = ref->index;
        r.opacity = image.mean()[0];
    } else {
        throw SceneError("wrong_type", "opacity must be a number or a texture", pointer);
    }
    if (!(low >= 0.0F && high <= 1.0F))
        throw SceneError("out_of_range", "opacity must be at least 0 and at most 1", pointer);
    r.emissive = r.emissive && high > 0.0F;
    r.passes = low < 1.0F || (r.lobes & kNull) != 0;
    if (low < 1.0F) r.lobes |= kNullLobes;
}

void read_maps(const MaterialDescription& d, const TextureTable& textures, MaterialRecord& r) {
    const auto known = [&](int index, const char* name) {
        if (index >= textures.size())
            throw SceneError("unknown_texture",
                             std::string(name) + " names a texture that does not exist",
                             d.pointer + "/" + name);
        return index;
    };
    r.normal_map = known(d.normal_map, "normal_map");
    r.bump_map = known(d.bump_map, "bump_map");
    r.bump_height = float(d.bump_height);
    if (!std::isfinite(r.bump_height))
        throw SceneError("out_of_range", "bump_height must be finite", d.pointer + "/bump_height");
}

MaterialRecord make_record(const MaterialDescription& d, const TextureTable& textures,
                           TableStore<float>& tables) {
    MaterialRecord r;
    r.recipe = make_recipe<float>(d, textures, tables);
    r.two_sided = d.two_sided;
    r.priority = d.priority;
    r.features = r.recipe.features();
    r.lobes = r.recipe.lobes();
    if (const auto* part = r.recipe.interface())
        visit_model(part->model(), [&]<class M>(const M& m) {
            if constexpr (InterfaceModel<M, float>) {
                r.has_interior = true;
                r.eta_interior = m.interior().eta;
                r.dispersive = r.eta_interior.min_value() != r.eta_interior.max_value();
                r.sigma_a = m.interior().sigma_a;
            }
        });
    read_emission(d, textures, r);
    read_opacity(d, textures, r);
    read_maps(d, textures, r);
    r.delta_only = (r.lobes & (kDiffuse | kGlossy)) == 0;
    if (r.recipe.textured()) r.features |= kFeatureTextured;
    if (r.emissive) r.features |= kFeatureEmission;
    return r;
}

}  // namespace

MaterialTable::MaterialTable(const std::vector<MaterialDescription>& descriptions,
                             const TextureTable& textures)
    : textures_(&textures), tables_(std::make_unique<TableStore<float>>()) {
    for (const auto& d : descriptions)
        for (const Spectrumd& eta : interior_indices(d)) tables_->media.push_back(eta);
    records_.reserve(descriptions.size());
    for (const auto& d : descriptions) records_.push_back(make_record(d, textures, *tables_));
}

Spectrumf MaterialTable::emission(int material, Vec2f uv) const {
    const MaterialRecord& r = (*this)[material];
    const Spectrumf full =
        r.emission_texture < 0 ? r.emission : (*textures_)[r.emission_texture].lookup(uv);
    return r.passes ? full * opacity(material, uv) : full;
}

float MaterialTable::opacity(int material, Vec2f uv) const {
    const MaterialRecord& r = (*this)[material];
    return r.opacity_texture < 0 ? r.opacity : (*textures_)[r.opacity_texture].lookup(uv)[0];
}

Vec3f MaterialTable::shading_normal(int material, const SurfacePoint& point) const {
    const MaterialRecord& r = (*this)[material];
    Vec3f n = point.n_s;
    if (r.normal_map >= 0) n = map_normal((*textures_)[r.normal_map], point, n);
    if (r.bump_map >= 0) n = bump_normal((*textures_)[r.bump_map], r.bump_height, point, n);
    return n;
}

float MaterialTable::pass_through(int material, Vec2f uv) const {
    const MaterialRecord& r = (*this)[material];
    if (!r.passes) return 0.0F;
    float null_share = 0.0F;
    if ((r.recipe.lobes() & kNull) != 0) {
        NestedModels<float> nested;
        null_share = r.recipe.textured()
                         ? model_null_share<float>(r.recipe.at(*textures_, uv, 1.0F, nested))
                         : model_null_share<float>(r.recipe.model());
    }
    return 1.0F - opacity(material, uv) * (1.0F - null_share);
}

Bsdf::Bsdf(const MaterialTable& table, int material, const SurfacePoint& point, Vec3f wo,
           float eta_rel)
    : n_g_(point.n_g), material_(material) {
    const MaterialRecord& record = table[material];
    const bool interface = (record.features & kFeatureTransmission) != 0;
    const bool mapped = record.normal_map >= 0 || record.bump_map >= 0;
    Vec3f n_s = mapped ? table.shading_normal(material, point) : point.n_s;
    if (dot(wo, n_g_) < 0.0F) {
        n_g_ = -n_g_;
        n_s = -n_s;
        black_ = !record.two_sided && !interface;
    }
    n_s = bend_towards(n_s, wo, n_g_);
    frame_ = (record.features & kFeatureAnisotropic) ? Framef::from_normal_tangent(n_s, point.dpdu)
                                                     : Framef::from_normal(n_s);
    if (record.recipe.textured() || record.has_interior)
        own_ = record.recipe.at(table.textures(), point.uv, eta_rel, nested_);
    else
        constant_ = &record.recipe.model();
    if (record.passes) opacity_ = table.opacity(material, point.uv);
}

BsdfEval<float> Bsdf::eval(Vec3f wo, Vec3f wi) const {
    const Vec3f local_o = frame_.to_local(wo);
    const Vec3f local_i = frame_.to_local(wi);
    const float side = dot(wi, n_g_);
    if (black_ || !(local_o.z > 0.0F) || !(local_i.z * side > 0.0F)) return {};
    BsdfEval<float> e = eval_model(model(), local_o, local_i);
    if (opacity_ < 1.0F) {
        e.f *= opacity_;
        e.pdf *= opacity_;
    }
    return e;
}

BsdfEval<float> Bsdf::eval(Vec3f wo, Vec3f wi, Counters& counters) const {
    const BsdfEval<float> e = eval(wo, wi);
    if (e.f.is_finite() && std::isfinite(e.pdf)) return e;
    counters.reject(Reject::kNonFiniteEval, material_);
    return {};
}

std::optional<BsdfSample<float>> Bsdf::sample(Vec3f wo, Vec3f u, Counters& counters) const {
    if (!(opacity_ < 1.0F)) return sample_surface(wo, u, counters);
    const float gap = 1.0F - opacity_;
    if (u.x < gap) return BsdfSample<float>{-wo, Spectrumf(1.0F), gap, kNullLobes};
    u.x = std::min((u.x - gap) / opacity_, kOneMinusEpsilon<float>);
    auto s = sample_surface(wo, u, counters);
    if (s) s->pdf *= opacity_;
    return s;
}

std::optional<BsdfSample<float>> Bsdf::sample_surface(Vec3f wo, Vec3f u, Counters& counters) const {
    const Vec3f local_o = frame_.to_local(wo);
    if (black_ || !(local_o.z > 0.0F)) return {};
    auto s = sample_model(model(), local_o, u);
    if (!s) return {};
    if (!s->weight.is_finite() || !std::isfinite(s->pdf) || !is_finite(s->wi)) {
        counters.reject(Reject::kNonFiniteSample, material_);
        return {};
    }
    if (s->weight.is_black() || !(s->pdf > 0.0F)) return {};
    // A direction above the shading horizon but below the surface (or the reverse) is absorbed, as
    // eval says; the surface would shadow it.
    if ((s->lobe & kNull) != 0) {
        s->wi = -wo;
        return s;
    }
    const float local_z = s->wi.z;
    s->wi = frame_.to_world(s->wi);
    if (!(local_z * dot(s->wi, n_g_) > 0.0F)) {
        counters.reject(Reject::kSideMismatch, material_);
        return {};
    }
    return s;
}

std::uint8_t Bsdf::lobes() const {
    const std::uint8_t gap = opacity_ < 1.0F ? kNullLobes : 0;
    if (black_ || opacity_ == 0.0F) return gap;
    return std::uint8_t(gap | model_lobes<float>(model()));
}

}  // namespace matiere
