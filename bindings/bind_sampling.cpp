// Vectorised views of the sample source and of light sampling: what the statistical tests look at.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "light/environment.h"
#include "sampling/discrete.h"
#include "sampling/sampler.h"
#include "scene/scene.h"

namespace py = pybind11;

namespace matiere {
namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

py::array_t<std::uint32_t> sampler_bits(std::uint64_t seed, std::uint32_t replicate, int x, int y,
                                        std::uint64_t first, py::ssize_t count,
                                        std::uint32_t bounce, std::uint32_t purpose) {
    py::array_t<std::uint32_t> out({count, py::ssize_t(4)});
    for (py::ssize_t i = 0; i < count; ++i) {
        const Sampler sampler(seed, replicate, x, y, first + std::uint64_t(i));
        const SampleBlock block = sampler.block(bounce, Purpose(purpose));
        for (py::ssize_t d = 0; d < 4; ++d) out.mutable_at(i, d) = block.bits[std::size_t(d)];
    }
    return out;
}

py::tuple discrete_sample(const std::vector<double>& weights, const Array<std::uint32_t>& u) {
    const DiscreteDistribution d(weights);
    py::array_t<double> probability{py::ssize_t(d.size())};
    for (std::size_t i = 0; i < d.size(); ++i)
        probability.mutable_at(py::ssize_t(i)) = double(d.probability(i));
    const py::ssize_t n = d.empty() ? 0 : u.size();
    py::array_t<std::uint32_t> index(n);
    py::array_t<double> remainder(n);
    for (py::ssize_t i = 0; i < n; ++i) {
        const auto c = d.sample(u.data()[i]);
        index.mutable_at(i) = c.index;
        remainder.mutable_at(i) = c.remainder;
    }
    return py::make_tuple(probability, index, remainder);
}

EnvironmentLight make_environment(const Array<float>& pixels, double rotation_deg) {
    if (pixels.ndim() != 3 || pixels.shape(2) != 3)
        throw py::value_error("pixels must have shape (H, W, 3)");
    return {int(pixels.shape(1)), int(pixels.shape(0)),
            std::vector<float>(pixels.data(), pixels.data() + pixels.size()), rotation_deg, 1.0};
}

using Normal = std::array<float, 3>;

Receiver receiver(const Normal& n) { return {{}, {n[0], n[1], n[2]}}; }

py::tuple environment_sample(const EnvironmentLight& e, const Array<std::uint32_t>& bits,
                             const Normal& normal) {
    const py::ssize_t n = bits.shape(0);
    py::array_t<float> wi({n, py::ssize_t(3)}), radiance({n, py::ssize_t(3)}), pdf(n);
    for (py::ssize_t i = 0; i < n; ++i) {
        SampleBlock u{};
        for (py::ssize_t d = 0; d < 4; ++d) u.bits[std::size_t(d)] = bits.at(i, d);
        const auto s = e.sample(receiver(normal), u);
        for (py::ssize_t k = 0; k < 3; ++k) {
            wi.mutable_at(i, k) = s ? s->wi[std::size_t(k)] : 0.0F;
            radiance.mutable_at(i, k) = s ? s->radiance[int(k)] : 0.0F;
        }
        pdf.mutable_at(i) = s ? s->pdf : 0.0F;
    }
    return py::make_tuple(wi, radiance, pdf);
}

py::tuple environment_eval(const EnvironmentLight& e, const Array<float>& directions,
                           const Normal& normal) {
    const py::ssize_t n = directions.shape(0);
    py::array_t<float> radiance({n, py::ssize_t(3)}), pdf(n);
    for (py::ssize_t i = 0; i < n; ++i) {
        const Vec3f w{directions.at(i, 0), directions.at(i, 1), directions.at(i, 2)};
        const Spectrumf L = e.radiance(w);
        for (py::ssize_t k = 0; k < 3; ++k) radiance.mutable_at(i, k) = L[int(k)];
        pdf.mutable_at(i) = e.pdf(receiver(normal), w);
    }
    return py::make_tuple(radiance, pdf);
}

}  // namespace

void bind_sampling(py::module_& m) {
    m.def("sampler_bits", &sampler_bits, py::arg("seed"), py::arg("replicate"), py::arg("x"),
          py::arg("y"), py::arg("first"), py::arg("count"), py::arg("bounce") = 0,
          py::arg("purpose") = 0,
          "Coordinates (count, 4) of one block as 0.32 fixed point (tests).");
    m.def("discrete_sample", &discrete_sample, py::arg("weights"), py::arg("u"),
          "Probabilities, and index and remainder for every u in 0.32 fixed point (tests).");
    py::class_<EnvironmentLight>(m, "EnvironmentLight",
                                 "A lat-long environment on its own (tests).")
        .def(py::init(&make_environment), py::arg("pixels"), py::arg("rotation_deg") = 0.0)
        .def("sample", &environment_sample, py::arg("bits"), py::arg("normal") = Normal{},
             "wi (N,3), radiance (N,3), pdf (N,), for a receiver with this normal or none")
        .def("eval", &environment_eval, py::arg("directions"), py::arg("normal") = Normal{},
             "radiance (N,3), pdf (N,)");
}

}  // namespace matiere
