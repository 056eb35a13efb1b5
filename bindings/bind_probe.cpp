// Vectorised access to single materials, without a scene: the probe API and the tests' way into
// optics.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <variant>

#include "base/error.h"
#include "base/parallel.h"
#include "material/record.h"
#include "param_value.h"

namespace py = pybind11;

namespace matiere {

void bind_probe_optics(py::module_& m);

namespace {

template <class R>
using Array = py::array_t<R, py::array::c_style | py::array::forcecast>;

/// Rows of three numbers; a single one stands for as many as the other array has.
template <class R>
class Rows {
 public:
    Rows(const py::object& o, const char* name) : array_(o.cast<Array<R>>()) {
        if (array_.ndim() == 1 && array_.shape(0) == 3) array_ = array_.reshape({1, 3});
        if (array_.ndim() != 2 || array_.shape(1) != 3)
            throw py::value_error(std::string(name) + " must have shape (N, 3) or (3,)");
    }
    py::ssize_t size() const { return array_.shape(0); }
    Vec3<R> operator[](py::ssize_t k) const {
        const R* p = array_.data(size() == 1 ? 0 : k, 0);
        return {p[0], p[1], p[2]};
    }
    static py::ssize_t common(const Rows& a, const Rows& b) {
        if (a.size() != b.size() && a.size() != 1 && b.size() != 1)
            throw py::value_error("both arrays must have the same number of rows, or one row");
        return a.size() == 1 ? b.size() : a.size();
    }

 private:
    Array<R> array_;
};

/// namedtuple matiere._core.BsdfSample; lives as long as the module.
PyObject* sample_type = nullptr;

/// Base-b digits of i mirrored about the point, for the albedo's sample set.
template <class R>
R radical_inverse(unsigned base, std::uint64_t i) {
    double inverse = 1.0 / base, scale = inverse, value = 0.0;
    for (; i; i /= base, scale *= inverse) value += double(i % base) * scale;
    return std::min(R(value), kOneMinusEpsilon<R>);
}

/// One model with constant parameters in one precision. Directions below the surface are seen as
/// `Bsdf` sees them: mirrored, and with the inverse relative index at an interface.
template <class R>
class Probe {
 public:
    explicit Probe(const MaterialDescription& d)
        : recipe_(make_recipe<R>(d, TextureTable(), tables_)), below_(recipe_.model()) {
        const ModelRecipe<R>* part = recipe_.interface();
        if (!part) return;
        visit_model(part->model(), [&]<class M>(const M& m) {
            if constexpr (InterfaceModel<M, R>)
                below_ =
                    recipe_.at(TextureTable(), {}, R(1) / m.interior().eta[kMiddleLane], nested_);
        });
    }
    Probe(const Probe&) = delete;
    Probe& operator=(const Probe&) = delete;

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        const bool below = wo.z < R(0);
        return eval_model(model(below), mirrored(wo, below), mirrored(wi, below));
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const bool below = wo.z < R(0);
        if (wo.z == R(0)) return {};
        auto s = sample_model(model(below), mirrored(wo, below), u);
        if (s) s->wi = mirrored(s->wi, below);
        return s;
    }

    std::uint8_t lobes() const { return model_lobes<R>(recipe_.model()); }
    bool is_stochastic() const { return model_is_stochastic<R>(recipe_.model()); }

    Array<R> eval_rows(const Rows<R>& wo, const Rows<R>& wi) const {
        const FlushDenormals as_in_a_render;
        const py::ssize_t n = Rows<R>::common(wo, wi);
        Array<R> f({n, py::ssize_t(3)});
        for (py::ssize_t k = 0; k < n; ++k) {
            const BsdfEval<R> e = eval(wo[k], wi[k]);
            for (int c = 0; c < 3; ++c) *f.mutable_data(k, c) = e.f[c];
        }
        return f;
    }

    Array<R> pdf_rows(const Rows<R>& wo, const Rows<R>& wi) const {
        const FlushDenormals as_in_a_render;
        const py::ssize_t n = Rows<R>::common(wo, wi);
        Array<R> pdf(n);
        for (py::ssize_t k = 0; k < n; ++k) *pdf.mutable_data(k) = eval(wo[k], wi[k]).pdf;
        return pdf;
    }

    py::object sample_rows(const Rows<R>& wo, const Rows<R>& u) const {
        const FlushDenormals as_in_a_render;
        const py::ssize_t n = Rows<R>::common(wo, u);
        Array<R> wi({n, py::ssize_t(3)}), weight({n, py::ssize_t(3)}), pdf(n), eta(n);
        Array<std::uint32_t> lobe(n);
        for (py::ssize_t k = 0; k < n; ++k) {
            const auto s = sample(wo[k], u[k]).value_or(BsdfSample<R>{});
            for (int c = 0; c < 3; ++c) {
                *wi.mutable_data(k, c) = s.wi[std::size_t(c)];
                *weight.mutable_data(k, c) = s.weight[c];
            }
            *pdf.mutable_data(k) = s.pdf;
            *eta.mutable_data(k) = s.eta;
            *lobe.mutable_data(k) = s.lobe;
        }
        return py::reinterpret_borrow<py::object>(sample_type)(wi, weight, pdf, lobe, eta);
    }

    Array<R> albedo_rows(const Rows<R>& wo, std::uint64_t samples) const {
        const FlushDenormals as_in_a_render;
        const py::ssize_t n = wo.size();
        Array<R> albedo({n, py::ssize_t(3)});
        for (py::ssize_t k = 0; k < n; ++k) {
            Spectrumd sum;
            for (std::uint64_t i = 0; i < samples; ++i) {
                const Vec3<R> u{radical_inverse<R>(3, i), radical_inverse<R>(2, i),
                                R((double(i) + 0.5) / double(samples))};
                if (const auto s = sample(wo[k], u))
                    sum += spectrum_cast<double>(s->weight) *
                           (double(s->eta) * double(s->eta));  // energy, not radiance
            }
            for (int c = 0; c < 3; ++c) *albedo.mutable_data(k, c) = R(sum[c] / double(samples));
        }
        return albedo;
    }

 private:
    static Vec3<R> mirrored(Vec3<R> w, bool below) { return {w.x, w.y, below ? -w.z : w.z}; }
    const AnyModel<R>& model(bool below) const { return below ? below_ : recipe_.model(); }

    TableStore<R> tables_;
    ModelRecipe<R> recipe_;
    AnyModel<R> below_;  // as seen from the other side
    NestedModels<R> nested_;
};

using AnyProbe = std::variant<Probe<float>, Probe<double>>;

class PyBsdf {
 public:
    PyBsdf(const std::string& type, const py::dict& params, const std::string& precision,
           const std::string& pointer) {
        MaterialDescription d;
        d.type = type;
        d.params = param_values(params);
        d.pointer = pointer;
        if (precision == "float")
            probe_ = std::make_unique<AnyProbe>(std::in_place_type<Probe<float>>, d);
        else if (precision == "double")
            probe_ = std::make_unique<AnyProbe>(std::in_place_type<Probe<double>>, d);
        else
            throw py::value_error("precision must be 'float' or 'double'");
    }

    template <class F>
    py::object visit(F&& f) const {
        return std::visit([&](const auto& p) -> py::object { return f(p); }, *probe_);
    }

 private:
    std::unique_ptr<AnyProbe> probe_;  // held by pointer: models keep views into their tables
};

template <class P>
struct RealOf;
template <class R>
struct RealOf<Probe<R>> {
    using Type = R;
};

}  // namespace

void bind_probe(py::module_& m) {
    py::object type = py::module_::import("collections")
                          .attr("namedtuple")("BsdfSample", "wi weight pdf lobe eta");
    type.attr("__module__") = m.attr("__name__");
    sample_type = type.inc_ref().ptr();
    m.attr("BsdfSample") = type;
    py::class_<PyBsdf>(m, "Bsdf", "One material model, vectorised, in float or double.")
        .def(
            py::init<const std::string&, const py::dict&, const std::string&, const std::string&>(),
            py::arg("type"), py::arg("params"), py::arg("precision") = "float",
            py::arg("pointer") = "")
        .def_property_readonly(
            "lobes",
            [](const PyBsdf& b) {
                return b.visit([](const auto& p) { return py::int_(p.lobes()); });
            })
        .def_property_readonly(
            "stochastic",
            [](const PyBsdf& b) {
                return b.visit([](const auto& p) { return py::bool_(p.is_stochastic()); });
            },
            "eval is an unbiased estimate, pdf a stand-in: weight is not eval / pdf.")
        .def(
            "eval",
            [](const PyBsdf& b, const py::object& wo, const py::object& wi) {
                return b.visit([&]<class P>(const P& p) {
                    using R = typename RealOf<P>::Type;
                    return p.eval_rows(Rows<R>(wo, "wo"), Rows<R>(wi, "wi"));
                });
            },
            py::arg("wo"), py::arg("wi"), "f |cos theta_i|, (N, 3).")
        .def(
            "pdf",
            [](const PyBsdf& b, const py::object& wo, const py::object& wi) {
                return b.visit([&]<class P>(const P& p) {
                    using R = typename RealOf<P>::Type;
                    return p.pdf_rows(Rows<R>(wo, "wo"), Rows<R>(wi, "wi"));
                });
            },
            py::arg("wo"), py::arg("wi"), "Density of sample per solid angle, (N,).")
        .def(
            "sample",
            [](const PyBsdf& b, const py::object& wo, const py::object& u) {
                return b.visit([&]<class P>(const P& p) {
                    using R = typename RealOf<P>::Type;
                    return p.sample_rows(Rows<R>(wo, "wo"), Rows<R>(u, "u"));
                });
            },
            py::arg("wo"), py::arg("u"),
            "(wi, weight, pdf, lobe, eta); a rejected row has pdf 0 and lobe 0.")
        .def(
            "albedo",
            [](const PyBsdf& b, const py::object& wo, std::uint64_t n) {
                return b.visit([&]<class P>(const P& p) {
                    using R = typename RealOf<P>::Type;
                    return p.albedo_rows(Rows<R>(wo, "wo"), n);
                });
            },
            py::arg("wo"), py::arg("n") = 4096,
            "Share of light scattered for each wo, by n samples, (N, 3).");
    bind_probe_optics(m);
}

}  // namespace matiere
