// One texture by itself, for tests.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <string>

#include "texel_grid.h"
#include "texture/texture.h"

namespace py = pybind11;

namespace matiere {
namespace {

py::array_t<float> colour(const Spectrumf& s) { return py::array_t<float>(3, s.v); }

/// A mip level as it is read: (H, W, 3).
py::array_t<float> level(const ImageTexture& t, int i) {
    if (i < 0 || i >= t.levels()) throw py::index_error("no such level");
    const TexelGrid& grid = t.level(i);
    py::array_t<float> out({grid.height, grid.width, 3});
    with_reader(grid, [&](const auto& read) {
        for (int y = 0; y < grid.height; ++y)
            for (int x = 0; x < grid.width; ++x)
                for (int c = 0; c < 3; ++c) out.mutable_at(y, x, c) = read(x, y)[c];
    });
    return out;
}

}  // namespace

void bind_texture(py::module_& m) {
    py::module_ probe = m.attr("probe");
    py::class_<ImageTexture>(probe, "Texture", "A texture by itself, for tests.")
        .def(py::init([](const py::array& pixels, const std::string& wrap,
                         const std::string& filter, bool srgb, const std::array<float, 6>& t) {
                 return ImageTexture(texel_grid(pixels, srgb),
                                     {wrap_from_name(wrap, ""),
                                      filter_from_name(filter, ""),
                                      0,
                                      {t[0], t[1], t[2], t[3], {t[4], t[5]}}},
                                     "");
             }),
             py::arg("pixels"), py::arg("wrap") = "repeat", py::arg("filter") = "bilinear",
             py::arg("srgb") = false, py::arg("transform") = std::array<float, 6>{1, 0, 0, 1, 0, 0})
        .def_property_readonly("levels", &ImageTexture::levels)
        .def_property_readonly("bytes", &ImageTexture::bytes)
        .def_property_readonly("mean", [](const ImageTexture& t) { return colour(t.mean()); })
        .def("level", &level, py::arg("index"))
        .def(
            "lookup",
            [](const ImageTexture& t, float u, float v, float area) {
                return colour(t.lookup({{Vec2f{u, v}, Vec2f{u, v}}, {area, area}}));
            },
            py::arg("u"), py::arg("v"), py::arg("area") = 0.0F,
            "The value at uv, averaged over a uv area where the texture is trilinear.");
}

}  // namespace matiere
