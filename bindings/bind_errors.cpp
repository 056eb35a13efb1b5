// SceneError as a Python exception with code, message and pointer; what this build is made of.
#include <pybind11/pybind11.h>

#include "accel/embree_device.h"
#include "base/error.h"
#include "build_info.h"

namespace py = pybind11;

namespace matiere {
namespace {

PyObject* scene_error_type = nullptr;  // lives as long as the module

void translate(std::exception_ptr pointer) {
    if (!pointer) return;
    try {
        std::rethrow_exception(pointer);
    } catch (const SceneError& e) {
        const auto type = py::reinterpret_borrow<py::object>(scene_error_type);
        py::object error = type(e.what());
        error.attr("code") = e.code();
        error.attr("message") = e.what();
        error.attr("pointer") = e.pointer();
        PyErr_SetObject(scene_error_type, error.ptr());
    }
}

py::dict info() {
    py::dict d;
    d["embree"] = embree_version();
    d["isa"] = embree_isa();
    d["compiler"] = build::kCompiler;
    d["flags"] = build::kFlags;
    d["source_hash"] = build::kSourceHash;
    return d;
}

}  // namespace

void bind_errors(py::module_& m) {
    scene_error_type = PyErr_NewExceptionWithDoc(
        "matiere._core.SceneError", "A scene that cannot be built: code, message and JSON pointer.",
        PyExc_ValueError, nullptr);
    m.add_object("SceneError", py::handle(scene_error_type));
    py::register_local_exception_translator(&translate);
    m.def("info", &info, "Embree version and ISA, compiler, flags and source hash of this build.");
}

}  // namespace matiere
