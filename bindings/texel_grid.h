// Numpy images as texels, in their own number format.
#pragma once

#include <pybind11/numpy.h>

#include <cstring>
#include <string>

#include "texture/texels.h"

namespace matiere {

/// (H, W, 3), (H, W, 1) or (H, W) of uint8, uint16, float16 or float32; `srgb` is for uint8.
inline TexelGrid texel_grid(const pybind11::array& pixels, bool srgb = false) {
    namespace py = pybind11;
    const auto a = py::array::ensure(pixels, py::array::c_style);
    const bool grey = a.ndim() == 2 || (a.ndim() == 3 && a.shape(2) == 1);
    if (!grey && (a.ndim() != 3 || a.shape(2) != 3))
        throw py::value_error("a texture must have shape (H, W, 3), (H, W, 1) or (H, W)");
    const std::string kind(1, a.dtype().kind());
    const std::string type = kind + std::to_string(a.itemsize());
    TexelGrid grid{int(a.shape(1)), int(a.shape(0)), grey ? 1 : 3, TexelFormat::kFloat, {}};
    if (type == "u1")
        grid.format = srgb ? TexelFormat::kByteSrgb : TexelFormat::kByte;
    else if (type == "u2")
        grid.format = TexelFormat::kShort;
    else if (type == "f2")
        grid.format = TexelFormat::kHalf;
    else if (type != "f4")
        throw py::value_error("a texture must be uint8, uint16, float16 or float32");
    if (srgb && type != "u1") throw py::value_error("only uint8 texels are decoded from sRGB");
    grid.bytes.resize(std::size_t(a.nbytes()));
    if (!grid.bytes.empty()) std::memcpy(grid.bytes.data(), a.data(), grid.bytes.size());
    return grid;
}

}  // namespace matiere
