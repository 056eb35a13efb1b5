// _core.probe: pieces of optics, sampling and texture for the oracles of the tests.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "material/bsdf_for.h"
#include "optics/absorption.h"
#include "optics/albedo_builder.h"
#include "optics/free_flight.h"
#include "optics/fresnel_term.h"
#include "optics/microfacet.h"
#include "optics/phase.h"
#include "param_value.h"
#include "sampling/photon_guide.h"
#include "texel_grid.h"

namespace py = pybind11;

namespace matiere {
namespace {

template <class R>
using Array = py::array_t<R, py::array::c_style | py::array::forcecast>;

Vec3f vec3_at(const Array<float>& a, py::ssize_t i) { return {a.at(i, 0), a.at(i, 1), a.at(i, 2)}; }

template <class R>
py::tuple fresnel_dielectric_rows(const Array<R>& cos_theta, const Array<R>& eta) {
    const auto one = [](R c, R n) { return fresnel_dielectric(c, n); };
    return py::make_tuple(
        py::vectorize([one](R c, R n) { return one(c, n).reflectance; })(cos_theta, eta),
        py::vectorize([one](R c, R n) { return one(c, n).transmittance; })(cos_theta, eta),
        py::vectorize([one](R c, R n) { return one(c, n).cos_theta_t; })(cos_theta, eta));
}

template <class R>
py::object fresnel_conductor_rows(const Array<R>& cos_theta, const Array<R>& eta,
                                  const Array<R>& k) {
    return py::vectorize([](R c, R n, R kappa) { return fresnel_conductor(c, n, kappa); })(
        cos_theta, eta, k);
}

template <class R, class F>
py::array_t<R> per_row(const Array<R>& w, F&& f) {
    if (w.ndim() != 2 || w.shape(1) != 3) throw py::value_error("directions must be (N, 3)");
    py::array_t<R> out(w.shape(0));
    for (py::ssize_t k = 0; k < w.shape(0); ++k)
        *out.mutable_data(k) = f(Vec3<R>{*w.data(k, 0), *w.data(k, 1), *w.data(k, 2)});
    return out;
}

/// Flights for rows of (u_lane, u): whether they meet something, how far they are, what they carry.
template <class R>
py::tuple sample_flights(const std::array<R, 3>& sigma_s, const std::array<R, 3>& sigma_t,
                         const std::array<R, 3>& carried, R end, const Array<R>& u) {
    const auto spectrum = [](const std::array<R, 3>& v) { return Spectrum<R>{v[0], v[1], v[2]}; };
    const auto n = u.shape(0);
    py::array_t<bool> meets(n);
    py::array_t<R> distance(n), out({n, py::ssize_t(3)});
    for (py::ssize_t i = 0; i < n; ++i) {
        const auto f = sample_flight(spectrum(sigma_s), spectrum(sigma_t), spectrum(carried), end,
                                     u.at(i, 0), u.at(i, 1));
        meets.mutable_at(i) = f.meets;
        distance.mutable_at(i) = f.distance;
        for (int c = 0; c < 3; ++c) out.mutable_at(i, c) = f.carried[c];
    }
    return py::make_tuple(meets, distance, out);
}

template <class R>
void bind_precision(py::module_& m, const std::string& suffix) {
    using Surface = Microfacet<R>;
    py::class_<Surface>(m, ("Microfacet" + suffix).c_str())
        .def(py::init([](R alpha_x, R alpha_y, int distribution, int masking) {
            return Surface::make(alpha_x, alpha_y, Distribution(distribution), Masking(masking));
        }))
        .def("D", [](const Surface& s,
                     const Array<R>& h) { return per_row(h, [&](Vec3<R> v) { return s.D(v); }); })
        .def("sigma", [](const Surface& s, const Array<R>& w) {
            return per_row(w, [&](Vec3<R> v) { return s.sigma(v); });
        });
    m.def(("fresnel_dielectric" + suffix).c_str(), &fresnel_dielectric_rows<R>);
    m.def(("fresnel_conductor" + suffix).c_str(), &fresnel_conductor_rows<R>);
    m.def(("erf_inv" + suffix).c_str(), py::vectorize([](R y) { return erf_inv(y); }));
    m.def(("beckmann_slope" + suffix).c_str(),
          py::vectorize([](R cot, R u) { return sample_beckmann_slope(cot, u); }));
    m.def(("fresnel_f82" + suffix).c_str(), py::vectorize([](R c, R F0, R tint) {
              return FresnelTerm<R>::f82(Spectrum<R>(F0), Spectrum<R>(tint))(c)[0];
          }));
    m.def(("beer_lambert" + suffix).c_str(), py::vectorize([](R sigma_a, R distance) {
              return beer_lambert(Spectrum<R>(sigma_a), distance)[0];
          }));
    m.def(("henyey_greenstein" + suffix).c_str(),
          py::vectorize([](R one_minus_cos, R g) { return henyey_greenstein(one_minus_cos, g); }));
    m.def(("sample_henyey_greenstein" + suffix).c_str(),
          py::vectorize([](R u, R g) { return sample_henyey_greenstein(u, g); }));
    m.def(("sample_flight" + suffix).c_str(), &sample_flights<R>);
}

/// A scene's material table, with textures, scattering at one point given by hand.
class PyMaterials {
 public:
    PyMaterials(const std::vector<py::dict>& materials, const std::vector<Array<float>>& textures,
                const std::string& wrap) {
        for (const auto& t : textures)
            textures_.add(ImageTexture(
                texel_grid(t), {wrap_from_name(wrap, ""), TextureFilter::kBilinear, 0, {}}, ""));
        std::vector<MaterialDescription> descriptions;
        for (const auto& m : materials) {
            MaterialDescription d;
            d.type = m["type"].cast<std::string>();
            d.params = param_values(m["params"].cast<py::dict>());
            if (m.contains("two_sided")) d.two_sided = m["two_sided"].cast<bool>();
            if (m.contains("emission")) d.emission = param_value(m["emission"]);
            if (m.contains("opacity")) d.opacity = param_value(m["opacity"]);
            d.pointer = "/materials/" + std::to_string(descriptions.size());
            descriptions.push_back(std::move(d));
        }
        table_ = std::make_unique<MaterialTable>(descriptions, textures_);
    }

    using V = std::array<float, 3>;
    static Vec3f v3(const V& v) { return {v[0], v[1], v[2]}; }

    std::unique_ptr<Bsdf> at(int material, const py::dict& point, const V& wo,
                             float eta_rel) const {
        SurfacePoint p{};
        p.n_g = v3(point["n_g"].cast<V>());
        p.n_s = v3(point["n_s"].cast<V>());
        if (point.contains("dpdu")) p.first.dpdu = v3(point["dpdu"].cast<V>());
        if (point.contains("uv")) {
            const auto uv = point["uv"].cast<std::array<float, 2>>();
            p.first.uv = {uv[0], uv[1]};
        }
        return std::make_unique<Bsdf>(*table_, material, p, v3(wo), eta_rel);
    }

    py::dict record(int material) const {
        const MaterialRecord& r = (*table_)[material];
        py::dict d;
        d["two_sided"] = r.two_sided;
        d["has_interior"] = r.has_interior;
        d["emissive"] = r.emissive;
        d["delta_only"] = r.delta_only;
        d["passes"] = r.passes;
        d["eta_interior"] = py::make_tuple(r.eta_interior[0], r.eta_interior[1], r.eta_interior[2]);
        d["dispersive"] = r.dispersive;
        const auto triple = [](const Spectrumf& s) { return py::make_tuple(s[0], s[1], s[2]); };
        d["sigma_a"] = triple(r.sigma_a);
        d["sigma_s"] = triple(r.sigma_s);
        d["sigma_t"] = triple(r.sigma_t);
        d["g"] = r.g;
        d["scatters"] = r.scatters;
        d["features"] = r.features;
        d["lobes"] = r.lobes;
        return d;
    }

    float pass_through(int material, float u, float v) const {
        return table_->pass_through(material, {{Vec2f{u, v}, Vec2f{u, v}}, {}});
    }

    py::array_t<float> emission(int material, float u, float v) const {
        const Spectrumf e = table_->emission(material, {{Vec2f{u, v}, Vec2f{u, v}}, {}});
        return py::array_t<float>(3, e.v);
    }

 private:
    TextureTable textures_;
    std::unique_ptr<MaterialTable> table_;
};

py::tuple world_eval(const PyMaterials& t, int material, const py::dict& point,
                     const PyMaterials::V& wo, const Array<float>& wi, float eta_rel) {
    const auto bsdf = t.at(material, point, wo, eta_rel);
    const py::ssize_t n = wi.shape(0);
    py::array_t<float> f({n, py::ssize_t(3)}), pdf(n);
    for (py::ssize_t k = 0; k < n; ++k) {
        const auto e =
            bsdf->eval(PyMaterials::v3(wo), {*wi.data(k, 0), *wi.data(k, 1), *wi.data(k, 2)});
        for (int c = 0; c < 3; ++c) *f.mutable_data(k, c) = e.f[c];
        *pdf.mutable_data(k) = e.pdf;
    }
    return py::make_tuple(f, pdf);
}

py::tuple world_sample(const PyMaterials& t, int material, const py::dict& point,
                       const PyMaterials::V& wo, const Array<float>& u, float eta_rel) {
    const auto bsdf = t.at(material, point, wo, eta_rel);
    const py::ssize_t n = u.shape(0);
    py::array_t<float> wi({n, py::ssize_t(3)}), weight({n, py::ssize_t(3)}), pdf(n);
    Counters counters;
    for (py::ssize_t k = 0; k < n; ++k) {
        const auto s = bsdf->sample(PyMaterials::v3(wo),
                                    {*u.data(k, 0), *u.data(k, 1), *u.data(k, 2)}, counters);
        for (int c = 0; c < 3; ++c) {
            *wi.mutable_data(k, c) = s ? s->wi[std::size_t(c)] : 0.0F;
            *weight.mutable_data(k, c) = s ? s->weight[c] : 0.0F;
        }
        *pdf.mutable_data(k) = s ? s->pdf : 0.0F;
    }
    py::dict rejected;
    for (int c = 0; c < kRejectCauses; ++c) {
        std::uint64_t sum = 0;
        for (const auto& row : counters.rejected) sum += row[std::size_t(c)];
        rejected[py::str(std::string(kRejectNames[std::size_t(c)]))] = sum;
    }
    return py::make_tuple(wi, weight, pdf, rejected);
}

/// Directional albedo of a surface over three lanes (1, (1-c)^5, c (1-c)^6), by quadrature and from
/// a table, at each cosine.
py::tuple albedo_table(double alpha, int distribution, int masking, const Array<double>& cosines) {
    const auto surface =
        Microfacet<double>::make(alpha, alpha, Distribution(distribution), Masking(masking));
    const AlbedoRow row = surface_row(surface, 0.0, FresnelTerm<double>::terms);
    const auto table = tabulate_albedo({&row, 1});
    const py::ssize_t n = cosines.shape(0);
    py::array_t<double> direct({n, py::ssize_t(3)}), looked_up({n, py::ssize_t(3)});
    for (py::ssize_t k = 0; k < n; ++k) {
        const double c = *cosines.data(k);
        const Vec3d wo{std::sqrt((1 - c) * (1 + c)), 0, c};
        const Spectrumd a = directional_albedo(surface, wo, FresnelTerm<double>::terms);
        const Spectrumd b = table.lookup(c);
        for (int lane = 0; lane < 3; ++lane) {
            *direct.mutable_data(k, lane) = a[lane];
            *looked_up.mutable_data(k, lane) = b[lane];
        }
    }
    const Spectrumd m = table.average[0];
    return py::make_tuple(direct, looked_up, py::make_tuple(m[0], m[1], m[2]));
}

PhotonGuide make_guide(const Array<float>& landed, const Array<float>& from,
                       const Array<float>& weight, double ordinary) {
    std::vector<GuidePhoton> photons;
    for (py::ssize_t i = 0; i < weight.size(); ++i)
        photons.push_back({vec3_at(landed, i), vec3_at(from, i), *weight.data(i)});
    return PhotonGuide(std::move(photons), ordinary);
}

const PhotonGuide::Region& region_at(const PhotonGuide& guide, const std::array<float, 3>& p) {
    const auto* region = guide.find({p[0], p[1], p[2]});
    if (region == nullptr) throw py::value_error("no photons landed there");
    return *region;
}

void bind_guide(py::module_& m) {
    using Point = std::array<float, 3>;
    py::class_<PhotonGuide>(m, "PhotonGuide")
        .def(py::init(&make_guide), py::arg("landed"), py::arg("origin"), py::arg("weight"),
             py::arg("ordinary"))
        .def("share",
             [](const PhotonGuide& g, const Point& p) {
                 const auto* region = g.find({p[0], p[1], p[2]});
                 return region == nullptr ? 0.0F : region->share();
             })
        .def("sample",
             [](const PhotonGuide& g, const Point& p, const Array<float>& u) {
                 const PhotonGuide::Region& region = region_at(g, p);
                 py::array_t<float> out({u.shape(0), py::ssize_t(3)});
                 for (py::ssize_t i = 0; i < u.shape(0); ++i) {
                     const Vec3f x = vec3_at(u, i);
                     const Vec3f w = region.sample({p[0], p[1], p[2]}, x.x, {x.y, x.z});
                     for (py::ssize_t k = 0; k < 3; ++k) out.mutable_at(i, k) = w[std::size_t(k)];
                 }
                 return out;
             })
        .def("pdf", [](const PhotonGuide& g, const Point& p, const Array<float>& w) {
            const PhotonGuide::Region& region = region_at(g, p);
            py::array_t<float> out(w.shape(0));
            for (py::ssize_t i = 0; i < w.shape(0); ++i)
                out.mutable_at(i) = region.pdf({p[0], p[1], p[2]}, vec3_at(w, i));
            return out;
        });
}

}  // namespace

void bind_probe_optics(py::module_& parent) {
    py::module_ m = parent.def_submodule("probe", "Pieces of the core, for tests.");
    bind_precision<float>(m, "_float");
    bind_precision<double>(m, "_double");
    py::class_<PyMaterials>(m, "Materials")
        .def(py::init<const std::vector<py::dict>&, const std::vector<Array<float>>&,
                      const std::string&>(),
             py::arg("materials"), py::arg("textures") = std::vector<Array<float>>(),
             py::arg("wrap") = "repeat")
        .def("record", &PyMaterials::record)
        .def("emission", &PyMaterials::emission)
        .def("pass_through", &PyMaterials::pass_through)
        .def("eval", &world_eval, py::arg("material"), py::arg("point"), py::arg("wo"),
             py::arg("wi"), py::arg("eta_rel") = 1.0F)
        .def("sample", &world_sample, py::arg("material"), py::arg("point"), py::arg("wo"),
             py::arg("u"), py::arg("eta_rel") = 1.0F);
    m.def("albedo_table", &albedo_table);
    bind_guide(m);
}

}  // namespace matiere
