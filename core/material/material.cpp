#include "material/material.h"

#include <algorithm>
#include <cmath>
#include <variant>

#include "base/error.h"
#include "material/bsdf_for.h"
#include "material/normal_map.h"

namespace matiere {
namespace {

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
                r.matched = m.interior().matched;
                r.sigma_a = m.interior().sigma_a;
                r.sigma_s = m.interior().sigma_s;
                r.sigma_t = r.sigma_a + r.sigma_s;
                r.g = m.interior().g;
                r.scatters = !r.sigma_s.is_black();
            }
        });
    read_emission(d, textures, r);
    read_opacity(d, textures, r);
    read_maps(d, textures, r);
    r.delta_only = (r.lobes & (kDiffuse | kGlossy)) == 0;
    if (r.recipe.textured()) r.features |= kFeatureTextured;
    r.made_at_hits = r.recipe.textured() || r.has_interior;
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

Spectrumf MaterialTable::emission(int material, const TexturePoint& at) const {
    const MaterialRecord& r = (*this)[material];
    const Spectrumf full =
        r.emission_texture < 0 ? r.emission : (*textures_)[r.emission_texture].fine(at);
    return r.passes ? full * opacity(material, at) : full;
}

float MaterialTable::opacity(int material, const TexturePoint& at) const {
    const MaterialRecord& r = (*this)[material];
    return r.opacity_texture < 0 ? r.opacity : (*textures_)[r.opacity_texture].fine(at)[0];
}

Vec3f MaterialTable::shading_normal(int material, const SurfacePoint& point) const {
    const MaterialRecord& r = (*this)[material];
    Vec3f n = point.n_s;
    if (r.normal_map >= 0) n = map_normal((*textures_)[r.normal_map], point, n);
    if (r.bump_map >= 0) n = bump_normal((*textures_)[r.bump_map], r.bump_height, point, n);
    return n;
}

float MaterialTable::pass_through(int material, const TexturePoint& at) const {
    const MaterialRecord& r = (*this)[material];
    if (!r.passes) return 0.0F;
    float null_share = 0.0F;
    if ((r.recipe.lobes() & kNull) != 0) {
        NestedModels<float> nested;
        null_share = r.recipe.textured()
                         ? model_null_share<float>(r.recipe.at(*textures_, at, 1.0F, nested))
                         : model_null_share<float>(r.recipe.model());
    }
    return 1.0F - opacity(material, at) * (1.0F - null_share);
}

}  // namespace matiere
