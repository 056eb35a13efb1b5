// Reflection as a gonioreflectometer saw it: MERL's isotropic tables and RGL's adaptive ones,
// isotropic and anisotropic. What the file holds is what is rendered: beyond 80 degrees both
// families are extrapolated, and some materials reflect more than they receive there; `check`
// prints it. MERL is reciprocal as stored; RGL is conditioned on the viewer.
// Sources: Matusik et al. 2003; Dupuy & Jakob 2018; `optics/measured_merl.h`, `measured_rgl.h`.
#pragma once

#include "material/model.h"
#include "optics/measured.h"

namespace matiere {

template <class R>
struct Measured {
    static constexpr std::string_view kName = "measured";
    static constexpr std::string_view kDoc = "A measured BRDF: a MERL .binary or RGL .bsdf file.";
    static constexpr std::string_view kSource = "Matusik et al. 2003; Dupuy & Jakob 2018";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureAnisotropic | kFeatureNotReciprocal;

    struct Params {
        Value<const TensorSet*> file;
        const MeasuredData* data = nullptr;

        static constexpr auto table() {
            return std::array{
                measured_file<Params, R>("file", &Params::file,
                                         "MERL .binary or RGL .bsdf (RGB or spectral).")
                    .required()};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    const MeasuredData* data = nullptr;

    static ParamError check(const Params& p) { return {"file", measured_problem(*p.file.v)}; }
    static void tabulate(Params& p, TableStore<R>& store) {
        p.data = store.keep(make_measured(*p.file.v));
        p.file.v = nullptr;  // the arrays are the description's: gone after the build
    }
    static Measured prepare(const Params& p) { return {p.data}; }

    bool is_anisotropic() const { return data->is_anisotropic(); }
    std::uint8_t lobes() const { return kGlossy | kReflection; }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const MeasuredValue v =
            data->eval(normalize(vec_cast<double>(wo)), normalize(vec_cast<double>(wi)));
        if (!(v.pdf > 0.0)) return {};
        return {spectrum_cast<R>(v.f), R(v.pdf)};
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const auto wi = data->sample(normalize(vec_cast<double>(wo)), vec_cast<double>(u));
        if (!wi) return {};
        const Vec3<R> rounded = vec_cast<R>(*wi);
        const BsdfEval<R> e = eval(wo, rounded);
        if (!(e.pdf > R(0))) return {};
        return BsdfSample<R>{rounded, e.f * (R(1) / e.pdf), e.pdf, kGlossy | kReflection};
    }
};

}  // namespace matiere
