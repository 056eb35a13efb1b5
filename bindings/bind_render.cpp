// Settings, cancel token, chunk rendering, the pass loop and its pure stop rule.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <memory>
#include <optional>
#include <string>

#include "base/error.h"
#include "film_dicts.h"
#include "integrator/kernels.h"
#include "render/fill_chunk.h"
#include "render/render.h"
#include "render/synthetic.h"
#include "scene/scene.h"

namespace py = pybind11;

namespace matiere {
namespace {

Strategy parse_strategy(const std::string& name) {
    if (name == "mis") return Strategy::kMis;
    if (name == "light") return Strategy::kLightOnly;
    if (name == "bsdf") return Strategy::kBsdfOnly;
    throw py::value_error("strategy must be mis, light or bsdf, not " + name);
}

LightTracing parse_light_tracing(const std::string& name) {
    if (name == "off") return LightTracing::kOff;
    if (name == "auto") return LightTracing::kAuto;
    if (name == "on") return LightTracing::kOn;
    throw py::value_error("light_tracing must be off, auto or on, not " + name);
}

/// The index of a kernel; "" lets the scene choose.
int parse_kernel(const std::string& name) {
    if (name.empty()) return -1;
    const auto all = kernels();
    for (std::size_t i = 0; i < all.size(); ++i)
        if (all[i].name == name) return int(i);
    throw py::value_error("no kernel is called " + name);
}

py::dict kernel_dict(const Kernel& kernel) {
    py::dict d;
    d["name"] = std::string(kernel.name);
    d["features"] = feature_names(kernel.features);
    return d;
}

bool has(const py::dict& d, const char* key) { return d.contains(key) && !d[key].is_none(); }

double positive(const py::object& value, const char* pointer) {
    const auto x = value.cast<double>();
    if (!(x > 0.0) || !std::isfinite(x))
        throw SceneError("bad_stop", "must be a positive number", pointer);
    return x;
}

/// {"spp": n, "seconds": s, "target_error": {"relmse": x}}, each absent or None if not asked for.
/// The target may be "rmse_percent" as well, or "display", which Python measures.
Stop parse_stop(const py::dict& d) {
    Stop stop;
    if (has(d, "spp")) {
        const auto spp = d["spp"].cast<long long>();
        if (spp < 1) throw SceneError("bad_spp", "spp must be at least 1", "/render/spp");
        stop.spp = std::uint64_t(spp);
    }
    if (has(d, "seconds")) stop.seconds = positive(d["seconds"], "/render/seconds");
    if (has(d, "target_error")) {
        const auto target = d["target_error"].cast<py::dict>();
        stop.measured = has(target, "display");
        if (has(target, "relmse"))
            stop.relmse = positive(target["relmse"], "/render/target_error/relmse");
        if (has(target, "rmse_percent"))
            stop.rmse_percent =
                positive(target["rmse_percent"], "/render/target_error/rmse_percent");
        if (stop.measured + (stop.relmse > 0.0) + (stop.rmse_percent > 0.0) != 1)
            throw SceneError("bad_stop",
                             "target_error needs one of \"relmse\", \"rmse_percent\", \"display\"",
                             "/render/target_error");
    }
    return stop;
}

py::dict row_dict(const PassRow& row) {
    py::dict d = error_dict(row.error);
    d["spp"] = row.spp;
    d["wall_s"] = row.wall_s;
    d["cpu_s"] = row.cpu_s;
    const double efficiency = row.efficiency();
    d["efficiency"] =
        efficiency > 0.0 ? py::object(py::float_(efficiency)) : py::object(py::none());
    d["rays"] = row.rays;
    d["rejected"] = row.rejected;
    return d;
}

py::object optional_seconds(double s) {
    return s >= 0.0 ? py::object(py::float_(s)) : py::object(py::none());
}

py::dict progress_dict(const Progress& p) {
    py::dict d;
    d["spp"] = p.spp;
    d["spp_limit"] = p.spp_limit;
    d["elapsed_s"] = p.elapsed_s;
    d["seconds_left"] = optional_seconds(p.seconds_left);
    d["error_spp"] = p.error_spp;
    d["error"] = p.error_spp > 0 ? py::object(error_dict(p.error)) : py::object(py::none());
    return d;
}

/// Python's side of the pass loop: the GIL is taken for each call and signals are looked at.
RenderHooks make_hooks(const py::object& callback, const py::object& measure) {
    RenderHooks hooks;
    if (!measure.is_none())
        hooks.measure = [&measure]() -> std::optional<double> {
            const py::gil_scoped_acquire gil;
            const py::object excess = measure();
            if (excess.is_none()) return std::nullopt;
            return excess.cast<double>();
        };
    hooks.poll = [] {
        const py::gil_scoped_acquire gil;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    };
    if (!callback.is_none())
        hooks.progress = [&callback](const Progress& p) {
            const py::gil_scoped_acquire gil;
            return !callback(progress_dict(p)).is(py::bool_(false));
        };
    return hooks;
}

py::dict outcome_dict(const RenderOutcome& outcome, const Stop& stop, const Film& film) {
    py::dict d;
    py::list log;
    for (const PassRow& row : outcome.log) log.append(row_dict(row));
    d["reason"] = std::string(outcome.reason);
    d["spp"] = film.spp();
    d["spp_limit"] = spp_limit(film.plan(), stop);
    d["threads"] = outcome.threads;
    d["wall_s"] = outcome.wall_s;
    d["pass_s"] = outcome.pass_s;
    d["error"] = error_dict(outcome.error);
    d["log"] = log;
    return d;
}

py::dict run_loop(const ChunkFunction& chunk, Film& film, const py::dict& stop_dict, int threads,
                  const py::object& callback, const std::shared_ptr<CancelToken>& cancel,
                  const py::object& measure = py::none()) {
    if (threads < 0 || threads > 1024) throw py::value_error("threads must be 0 to 1024");
    const Stop stop = parse_stop(stop_dict);
    const RenderHooks hooks = make_hooks(callback, measure);
    const auto token = cancel ? cancel : std::make_shared<CancelToken>();
    RenderOutcome outcome;
    {
        const py::gil_scoped_release release;
        outcome = render_passes(chunk, stop, film, threads, hooks, *token);
    }
    return outcome_dict(outcome, stop, film);
}

py::dict render_synthetic(Film& film, const std::string& kind, const py::dict& stop, double spread,
                          std::uint64_t seed, int threads, const py::object& callback,
                          const std::shared_ptr<CancelToken>& cancel, std::uint32_t repeat_after) {
    const auto parsed = synthetic_kind(kind);
    if (!parsed) throw py::value_error("unknown synthetic integrand " + kind);
    const Synthetic sampler{*parsed, seed, spread, repeat_after};
    const Plan plan = film.plan();
    const ChunkFunction chunk = [&](std::uint32_t index, const CancelToken& token) {
        return fill_chunk(plan, index, {{}, sampler.seed, 0, 0, 0}, token, sampler);
    };
    return run_loop(chunk, film, stop, threads, callback, cancel);
}

py::dict next_step_dict(const Plan& plan, const py::dict& stop_dict, const py::dict& state) {
    const Stop stop = parse_stop(stop_dict);
    RenderState now;
    if (has(state, "spp")) now.spp = state["spp"].cast<std::uint64_t>();
    if (has(state, "elapsed_s")) now.elapsed_s = state["elapsed_s"].cast<double>();
    if (has(state, "s_per_spp")) now.s_per_spp = state["s_per_spp"].cast<double>();
    if (has(state, "excess")) {
        now.excess = state["excess"].cast<double>();
        now.error_known = true;
        now.error_spp =
            has(state, "error_spp") ? state["error_spp"].cast<std::uint64_t>() : now.spp;
    }
    const Step step = next_step(plan, stop, now);
    py::dict d;
    d["go_on"] = step.go_on;
    d["next_spp"] = step.next_spp;
    d["reason"] =
        step.go_on ? py::object(py::none()) : py::object(py::str(std::string(step.reason)));
    d["look"] = look_due(plan, stop, now.spp);
    d["seconds_left"] = optional_seconds(seconds_left(plan, stop, now));
    return d;
}

std::string settings_repr(const Settings& s) {
    return "Settings(seed=" + std::to_string(s.seed) +
           ", max_depth=" + std::to_string(s.max_depth) + ")";
}

void bind_settings(py::module_& m) {
    py::class_<Settings>(m, "Settings", "What decides the value of a sample, beside the scene.")
        .def(py::init([](std::uint64_t seed, int max_depth, const std::string& strategy,
                         bool transparent_background, bool guide_caustics,
                         const std::string& kernel, float threshold,
                         const std::vector<std::string>& aovs, const std::string& light_tracing) {
                 return Settings{seed,
                                 max_depth,
                                 parse_strategy(strategy),
                                 transparent_background,
                                 guide_caustics,
                                 threshold,
                                 parse_kernel(kernel),
                                 aov_set(aovs),
                                 parse_light_tracing(light_tracing)};
             }),
             py::arg("seed") = 0, py::arg("max_depth") = -1, py::arg("strategy") = "mis",
             py::arg("transparent_background") = false, py::arg("guide_caustics") = true,
             py::arg("kernel") = "", py::arg("threshold") = 0.0F,
             py::arg("aovs") = std::vector<std::string>(), py::arg("light_tracing") = "off")
        .def_readonly("seed", &Settings::seed)
        .def_readonly("max_depth", &Settings::max_depth)
        .def_readonly("transparent_background", &Settings::transparent_background)
        .def("__repr__", &settings_repr);
    py::class_<CancelToken, std::shared_ptr<CancelToken>>(m, "CancelToken")
        .def(py::init<>())
        .def("cancel", &CancelToken::cancel)
        .def_property_readonly("cancelled", &CancelToken::cancelled);
    m.attr("DEFAULT_REPLICATES") = kDefaultReplicates;
}

}  // namespace

void bind_render(py::module_& m) {
    bind_settings(m);
    m.def("kernels", [] {
        py::list all;
        for (const Kernel& kernel : kernels()) all.append(kernel_dict(kernel));
        return all;
    });
    m.def(
        "kernel_of",
        [](const Scene& scene, const Settings& settings) {
            py::dict d = kernel_dict(kernel_for(scene.features(), settings));
            d["found"] = feature_names(scene.features());
            return d;
        },
        py::arg("scene"), py::arg("settings"),
        "The kernel of a render, the features it has code for, and those found in the scene.");
    m.def(
        "has_light_layer",
        [](const Scene& scene, const Settings& settings) {
            return light_layer(scene, settings) != nullptr;
        },
        py::arg("scene"), py::arg("settings"), "Whether paths from the lights take part.");
    m.def(
        "render_chunk",
        [](const Scene& scene, const Settings& settings, const Plan& plan, std::uint32_t index,
           const std::shared_ptr<CancelToken>& cancel) {
            const auto token = cancel ? cancel : std::make_shared<CancelToken>();
            const py::gil_scoped_release release;
            return render_chunk(scene, settings, plan, index, *token);
        },
        py::arg("scene"), py::arg("settings"), py::arg("plan"), py::arg("index"),
        py::arg("cancel") = nullptr, "One chunk on this thread; None if cancelled meanwhile.");
    m.def(
        "render",
        [](const Scene& scene, const Settings& settings, Film& film, const py::dict& stop,
           int threads, const py::object& callback, const std::shared_ptr<CancelToken>& cancel,
           const py::object& measure) {
            const Plan plan = film.plan();
            const ChunkFunction chunk = [&](std::uint32_t index, const CancelToken& token) {
                return render_chunk(scene, settings, plan, index, token);
            };
            return run_loop(chunk, film, stop, threads, callback, cancel, measure);
        },
        py::arg("scene"), py::arg("settings"), py::arg("film"), py::arg("stop"),
        py::arg("threads") = 0, py::arg("callback") = py::none(), py::arg("cancel") = nullptr,
        py::arg("measure") = py::none(), "Continue a film to the first of the stop conditions.");
    m.def("render_synthetic", &render_synthetic, py::arg("film"), py::arg("kind"), py::arg("stop"),
          py::arg("spread") = 1.0, py::arg("seed") = 0, py::arg("threads") = 0,
          py::arg("callback") = py::none(), py::arg("cancel") = nullptr,
          py::arg("repeat_after") = 0, "The pass loop on an integrand of known mean: tests only.");
    m.def("synthetic_mean", py::vectorize(&Synthetic::mean), py::arg("x"), py::arg("y"));
    m.def("next_step", &next_step_dict, py::arg("plan"), py::arg("stop"), py::arg("state"),
          "The stop rule: go_on, next_spp, reason, look (due at this spp), seconds_left.");
    m.def("available_threads", &available_threads, "Threads this process may use.");
}

}  // namespace matiere
