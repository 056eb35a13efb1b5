// Where the light of one sample came from: the recording kernel, and the outliers of films.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <string>
#include <vector>

#include "film_dicts.h"
#include "integrator/kernels.h"
#include "integrator/path_record.h"
#include "material/bsdf.h"
#include "scene/scene.h"

namespace py = pybind11;

namespace matiere {
namespace {

template <class V>
std::array<float, 3> triple(const V& v) {
    return {v[0], v[1], v[2]};
}

py::object index_or_none(int i) { return i < 0 ? py::object(py::none()) : py::object(py::int_(i)); }

py::object text_or_none(std::string_view text) {
    return text.empty() ? py::object(py::none()) : py::object(py::str(std::string(text)));
}

std::vector<std::string> lobe_names(std::uint8_t lobe) {
    std::vector<std::string> names;
    for (const auto& [bit, name] :
         {std::pair{kDiffuse, "diffuse"}, std::pair{kGlossy, "glossy"},
          std::pair{kSpecular, "specular"}, std::pair{kReflection, "reflection"},
          std::pair{kTransmission, "transmission"}})
        if ((lobe & bit) != 0) names.emplace_back(name);
    return names;
}

py::dict meeting_dict(const LightMeeting& m, const Scene& scene) {
    py::dict d;
    d["how"] = std::string(m.how);
    d["light"] = index_or_none(m.light);
    d["kind"] = text_or_none(m.light < 0 ? "" : scene.lights().kind(m.light));
    d["direction"] = triple(m.direction);
    d["pdf_light"] = m.pdf_light;
    d["pdf_bsdf"] = m.pdf_bsdf;
    d["mis_weight"] = m.mis_weight;
    d["contribution"] = triple(m.contribution);
    d["blocked"] = m.blocked;
    return d;
}

py::list meetings(const std::vector<LightMeeting>& all, const Scene& scene) {
    py::list list;
    for (const LightMeeting& m : all) list.append(meeting_dict(m, scene));
    return list;
}

py::dict vertex_dict(const PathVertex& v, const Scene& scene) {
    py::dict d;
    d["event"] = std::string(v.event);
    d["position"] = triple(v.p);
    d["n_g"] = triple(v.n_g);
    d["n_s"] = triple(v.n_s);
    d["distance"] = v.distance;
    d["material"] = index_or_none(v.material);
    d["light"] = index_or_none(v.light);
    d["medium"] = index_or_none(v.medium);
    d["outside"] = v.outside;
    d["throughput"] = triple(v.throughput);
    d["lobe"] = lobe_names(v.lobe);
    d["pdf"] = v.pdf;
    d["guided"] = v.guided;
    d["weight"] = triple(v.weight);
    d["eta"] = v.eta;
    d["survival"] = v.survival;
    d["lane"] = index_or_none(v.lane);
    d["lights"] = meetings(v.lights, scene);
    return d;
}

py::dict record_dict(const PathRecord& record, const Scene& scene) {
    py::dict d;
    d["origin"] = triple(record.origin);
    d["direction"] = triple(record.direction);
    py::list vertices;
    for (const PathVertex& v : record.vertices) vertices.append(vertex_dict(v, scene));
    d["vertices"] = vertices;
    d["background"] = meetings(record.background, scene);
    d["end"] = text_or_none(record.end);
    d["value"] = triple(record.result.L);
    d["alpha"] = record.result.alpha;
    return d;
}

}  // namespace

py::list feature_names(Features features) {
    py::list names;
    for (const FeatureName& f : kFeatureNames)
        if (has(features, f.bit)) names.append(std::string(f.name));
    return names;
}

py::dict provenance_dict(const Provenance& p) {
    py::dict d;
    py::list names, left_out, outliers;
    Features made = 0;
    for (std::size_t i = 0; i < kernels().size(); ++i)
        if ((p.kernels >> i & 1U) != 0) {
            names.append(std::string(kernels()[i].name));
            made |= kernels()[i].features;
        }
    d["kernels"] = names;
    d["found"] = feature_names(p.found);
    d["left_out"] = feature_names(p.kernels == 0 ? 0 : kKernelFeatures & ~made);
    for (const Outlier& o : p.outliers.list()) {
        py::dict row;
        row["pixel"] = std::array{o.x, o.y};
        row["replicate"] = o.replicate;
        row["sample"] = o.index;
        row["seed"] = o.seed;
        row["value"] = o.value;
        row["luminance"] = o.luminance();
        outliers.append(row);
    }
    d["outliers"] = outliers;
    return d;
}

void bind_replay(py::module_& m) {
    m.def(
        "replay",
        [](const Scene& scene, const PathSettings& settings, int x, int y, std::uint32_t replicate,
           std::uint64_t sample) {
            return record_dict(record_path(scene, settings, {x, y, replicate, sample}), scene);
        },
        py::arg("scene"), py::arg("settings"), py::arg("x"), py::arg("y"), py::arg("replicate"),
        py::arg("sample"), "One sample again, vertex by vertex; the pixel is of the whole film.");
}

}  // namespace matiere
