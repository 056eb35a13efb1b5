// The module matiere._core: one bind function per part of the core.
#include <pybind11/pybind11.h>

namespace matiere {
void bind_errors(pybind11::module_& m);
void bind_material(pybind11::module_& m);
void bind_probe(pybind11::module_& m);
void bind_sampling(pybind11::module_& m);
void bind_scene(pybind11::module_& m);
void bind_film(pybind11::module_& m);
void bind_render(pybind11::module_& m);
void bind_replay(pybind11::module_& m);
void bind_texture(pybind11::module_& m);
}  // namespace matiere

PYBIND11_MODULE(_core, m) {
    m.doc() = "The matiere render core.";
    matiere::bind_errors(m);
    matiere::bind_material(m);
    matiere::bind_probe(m);
    matiere::bind_sampling(m);
    matiere::bind_scene(m);
    matiere::bind_film(m);
    matiere::bind_render(m);
    matiere::bind_replay(m);
    matiere::bind_texture(m);
}
