// Plan, chunk films and films; arrays are views that keep their film alive.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstring>
#include <string_view>

#include "base/student.h"
#include "film/counter_fields.h"
#include "film/estimate.h"
#include "film/film.h"
#include "film/filter.h"
#include "film_dicts.h"

namespace py = pybind11;

namespace matiere {
namespace {

std::span<const std::byte> as_span(const py::bytes& bytes) {
    const std::string_view view = bytes;
    return {reinterpret_cast<const std::byte*>(view.data()), view.size()};
}

py::bytes as_bytes(const std::vector<std::byte>& bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// A read-only view into memory that `owner` holds.
template <class T>
py::array_t<T> view(std::span<const T> values, const std::vector<py::ssize_t>& shape,
                    const py::object& owner) {
    py::array_t<T> array(shape, values.data(), owner);
    py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
    return array;
}

py::array_t<double> image(const Film& film, const std::vector<double>& values) {
    py::array_t<double> array(
        {py::ssize_t(film.height()), py::ssize_t(film.width()), py::ssize_t(kColorChannels)});
    std::memcpy(array.mutable_data(), values.data(), values.size() * sizeof(double));
    return array;
}

template <std::vector<double> (*F)(const Film&)>
py::array_t<double> image_of(const Film& film) {
    std::vector<double> values;
    {
        const py::gil_scoped_release release;
        values = F(film);
    }
    return image(film, values);
}

py::array_t<double> film_mean(const Film& film) {
    py::array_t<double> array(
        {py::ssize_t(film.height()), py::ssize_t(film.width()), py::ssize_t(kFilmChannels)});
    double* out = array.mutable_data();
    for (std::size_t p = 0; p < film.pixels(); ++p)
        for (int c = 0; c < kFilmChannels; ++c) *out++ = film.mean(p, c, -1);
    return array;
}

py::array_t<double> replicate_means(const Film& film) {
    py::array_t<double> array({py::ssize_t(film.replicates()), py::ssize_t(film.height()),
                               py::ssize_t(film.width()), py::ssize_t(kFilmChannels)});
    double* out = array.mutable_data();
    for (int r = 0; r < film.replicates(); ++r)
        for (std::size_t p = 0; p < film.pixels(); ++p)
            for (int c = 0; c < kFilmChannels; ++c) *out++ = film.mean(p, c, r);
    return array;
}

py::array_t<float> sample_filter(const Filter& filter,
                                 const py::array_t<float, py::array::c_style>& u) {
    if (u.ndim() != 2 || u.shape(1) != 2) throw py::value_error("u must have shape (N, 2)");
    py::array_t<float> offsets({u.shape(0), py::ssize_t(2)});
    for (py::ssize_t i = 0; i < u.shape(0); ++i) {
        const Vec2f o = filter.sample({u.at(i, 0), u.at(i, 1)});
        offsets.mutable_at(i, 0) = o.x;
        offsets.mutable_at(i, 1) = o.y;
    }
    return offsets;
}

/// Positions `done` and on in the order of an adaptive film, at most `most` of them unless the next
/// round has more; `ends` holds [samples per pixel, position] of the rounds among them, the last
/// one that is complete first.
py::dict film_course(const Film& film, std::size_t most) {
    if (!film.adaptive()) throw py::value_error("only an adaptive film of one seed has a course");
    const AdaptiveState& state = *film.adaptive();
    const Allocation& allocation = state.allocation();
    const std::uint64_t rounds = state.rounds();
    const std::size_t start = state.done();
    const std::size_t least = allocation.round_end(rounds + 1);
    const std::size_t stop = std::max(least, std::min(start + most, allocation.order().size()));
    py::list ends;
    for (std::uint64_t k = rounds; k <= allocation.rounds(stop); ++k)
        ends.append(py::make_tuple(film.plan().boundary(k), allocation.round_end(k)));
    const auto order = allocation.order().subspan(start, stop - start);
    py::dict d;
    d["start"] = start;
    d["order"] = py::cast(std::vector<std::uint32_t>(order.begin(), order.end()));
    d["ends"] = ends;
    return d;
}

void bind_plan(py::module_& m) {
    py::class_<Plan>(m, "Plan", "The chunk plan of a film: a function of size and replicates.")
        .def(py::init<int, int, int, bool>(), py::arg("width"), py::arg("height"),
             py::arg("replicates"), py::arg("adaptive") = false)
        .def_property_readonly("width", &Plan::width)
        .def_property_readonly("height", &Plan::height)
        .def_property_readonly("replicates", &Plan::replicates)
        .def_property_readonly("adaptive", &Plan::adaptive)
        .def_property_readonly("tiles", &Plan::tiles)
        .def_property_readonly("strips", &Plan::strips, "Tiles, or tiles x halves if adaptive.")
        .def_property_readonly("tile_edge", &Plan::tile_edge)
        .def_property_readonly("version", [](const Plan&) { return Plan::kVersion; })
        .def("boundary", &Plan::boundary, py::arg("k"), "Samples per pixel after k ranges.")
        .def("ranges", &Plan::ranges, py::arg("spp"), "Ranges that hold at least spp samples.")
        .def("round_up", &Plan::round_up, py::arg("spp"), "The smallest boundary >= spp.")
        .def("chunk_count", &Plan::chunk_count, py::arg("spp"))
        .def("is_look", &Plan::is_look, py::arg("spp"), py::arg("per_octave") = 2)
        .def("look_number", &Plan::look_number, py::arg("spp"),
             "Looks of a run up to this spp, from 1.")
        .def(
            "chunk",
            [](const Plan& plan, std::uint32_t index) {
                const Chunk c = plan.chunk(index);
                py::dict d;
                d["index"] = c.index;
                d["layer"] = "camera";
                d["x0"] = c.x0;
                d["y0"] = c.y0;
                d["x1"] = c.x1;
                d["y1"] = c.y1;
                d["s0"] = c.s0;
                d["s1"] = c.s1;
                d["r0"] = c.r0;
                d["r1"] = c.r1;
                return d;
            },
            py::arg("index"));
    m.attr("MAX_SPP") = Plan::kMaxSpp;
    m.attr("OPEN_ENDED_SPP") = Plan::kOpenEndedSpp;
}

void bind_chunk_film(py::module_& m) {
    py::class_<ChunkFilm>(m, "ChunkFilm", "The sums of one chunk, starting from zero.")
        .def_property_readonly("index", [](const ChunkFilm& c) { return c.chunk().index; })
        .def_property_readonly("counters",
                               [](const ChunkFilm& c) { return counters_dict(c.work()); })
        .def_property_readonly("provenance",
                               [](const ChunkFilm& c) { return provenance_dict(c.provenance()); })
        .def_property_readonly("sums",
                               [](const py::object& self) {
                                   const auto& c = self.cast<const ChunkFilm&>();
                                   return view(c.sums(),
                                               {c.chunk().replicates(), c.chunk().height(),
                                                c.chunk().width(), kFilmChannels},
                                               self);
                               })
        .def_property_readonly("has_light_layer", &ChunkFilm::has_splats)
        .def_property_readonly("light_paths", &ChunkFilm::light_paths, "Of each replicate.")
        .def("to_bytes", [](const ChunkFilm& c) { return as_bytes(c.to_bytes()); })
        .def_static(
            "from_bytes", [](const py::bytes& b) { return ChunkFilm::from_bytes(as_span(b)); },
            py::arg("data"));
}

py::list tile_dicts(const Film& film, int edge);

py::dict cut_energy_dict(const Film& film, const std::string& cause) {
    if (cause != "max_depth" && cause != "threshold")
        throw py::value_error("cause must be max_depth or threshold, not " + cause);
    const CutEnergy e = film.cut_energy(cause == "max_depth" ? Cut::kDepth : Cut::kThreshold);
    py::dict d;
    d["paths"] = e.paths;
    d["followed"] = e.followed;
    d["radiance"] = e.radiance;
    d["standard_error"] = e.standard_error;
    return d;
}

py::array_t<double> film_light_mean(const Film& film) {
    py::array_t<double> out({film.height(), film.width(), kSplatChannels});
    double* to = out.mutable_data();
    const auto pixels = std::size_t(film.width()) * std::size_t(film.height());
    for (std::size_t i = 0; i < pixels; ++i)
        for (int c = 0; c < kSplatChannels; ++c) *to++ = film.light_mean(i, c, -1);
    return out;
}

py::list film_aovs(const Film& film) {
    py::list names;
    for (std::size_t i = 0; i < kAovs.size(); ++i)
        if (film.layout().has(Aov(i))) names.append(std::string(kAovs[i].name));
    return names;
}

py::array_t<double> film_aov(const Film& film, const std::string& name) {
    const auto aov = aov_from_name(name);
    if (!aov) throw py::value_error("no layer is called " + name);
    std::vector<double> values;
    {
        const py::gil_scoped_release release;
        values = film.aov(*aov);
    }
    py::array_t<double> array({py::ssize_t(film.height()), py::ssize_t(film.width()),
                               py::ssize_t(kAovs[std::size_t(*aov)].channels)});
    std::memcpy(array.mutable_data(), values.data(), values.size() * sizeof(double));
    return array;
}

void bind_light_layer(py::class_<Film>& film) {
    film.def_property_readonly("has_light_layer", &Film::has_light_layer,
                               "Whether paths from the lights took part.")
        .def_property_readonly(
            "light_paths",
            [](const Film& f) { return std::array{f.light_paths(0), f.light_paths(1)}; },
            "Of each replicate: of all, 0; or of either half where the plan is adaptive.")
        .def_property_readonly(
            "light_sums",
            [](const py::object& self) -> py::object {
                const auto& f = self.cast<const Film&>();
                if (!f.has_light_layer()) return py::none();
                return view(f.light_sums(), {f.replicates(), f.height(), f.width(), kSplatChannels},
                            self);
            },
            "Sums over the light paths of every replicate; None without a light layer.")
        .def("light_mean", &film_light_mean, "(H, W, 3) the light layer's part of the mean.");
}

void bind_film_class(py::module_& m) {
    py::class_<Film> film(m, "Film",
                          "Replicate sums of an image, folded chunk by chunk in double.");
    bind_light_layer(film);
    film.def(py::init<int, int, int, bool>(), py::arg("width"), py::arg("height"),
             py::arg("replicates"), py::arg("adaptive") = false)
        .def_property_readonly("width", &Film::width)
        .def_property_readonly("height", &Film::height)
        .def_property_readonly("replicates", &Film::replicates)
        .def_property_readonly("merged", &Film::merged)
        .def_property_readonly("plan", &Film::plan, py::return_value_policy::copy)
        .def_property_readonly("spp", &Film::spp, "Samples every pixel has at least.")
        .def_property_readonly("counters",
                               [](const Film& film) { return counters_dict(film.work()); })
        .def_property_readonly(
            "provenance", [](const Film& film) { return provenance_dict(film.provenance()); },
            "Features found, kernels used, and the brightest samples.")
        .def_property_readonly(
            "sums",
            [](const py::object& self) {
                const auto& f = self.cast<const Film&>();
                return view(f.sums(), {f.replicates(), f.height(), f.width(), kFilmChannels}, self);
            })
        .def_property_readonly("counts",
                               [](const py::object& self) {
                                   const auto& f = self.cast<const Film&>();
                                   return view(f.counts(), {f.height(), f.width()}, self);
                               })
        .def_property_readonly(
            "first_counts",
            [](const py::object& self) -> py::object {
                const auto& f = self.cast<const Film&>();
                if (f.first_counts().empty()) return py::none();
                return view(f.first_counts(), {f.height(), f.width()}, self);
            },
            "Samples in the first half of the replicates; None unless the plan is adaptive.")
        .def("cut_energy", &cut_energy_dict, py::arg("cause"),
             "What max_depth or threshold cut off: paths, followed, radiance, standard_error.")
        .def("course", &film_course, py::arg("most"),
             "Of an adaptive film: done, the next chunks by position, and where rounds end.")
        .def("next_chunk", &Film::next_chunk, py::arg("strip"))
        .def("missing", &Film::missing, py::arg("spp"),
             "Chunks to add next on the way to spp: all, or those that are decided.")
        .def("add", &Film::add, py::arg("chunk"), py::call_guard<py::gil_scoped_release>())
        .def("merge", &Film::merge, py::arg("other"), py::call_guard<py::gil_scoped_release>())
        .def("copy", [](const Film& film) { return Film(film); })
        .def("mean", &film_mean, "(H, W, 4) mean of R, G, B and alpha.")
        .def("replicate_means", &replicate_means, "(R, H, W, 4) mean of each replicate.")
        .def("mean_variance", &image_of<&mean_variance>)
        .def("standard_error", &image_of<&standard_error>)
        .def("error_weights", &image_of<&error_weights>)
        .def("tiles", &tile_dicts, py::arg("edge"), "estimate() of every square of `edge` pixels.")
        .def("estimate",
             [](const Film& film) {
                 ErrorEstimate e;
                 {
                     const py::gil_scoped_release release;
                     e = estimate_error(film);
                 }
                 return error_dict(e);
             })
        .def_property_readonly("aovs", &film_aovs, "Names of the layers beside the light.")
        .def("aov", &film_aov, py::arg("name"), "(H, W, C) mean of a layer; SceneError if absent.")
        .def("to_bytes", [](const Film& film) { return as_bytes(film.to_bytes()); })
        .def_static(
            "from_bytes", [](const py::bytes& b) { return Film::from_bytes(as_span(b)); },
            py::arg("data"))
        .def_static(
            "bytes_per_pixel",
            [](int replicates, bool adaptive, const std::vector<std::string>& aovs,
               bool light_layer) {
                return Film::bytes_per_pixel(replicates, adaptive, aov_set(aovs), light_layer);
            },
            py::arg("replicates"), py::arg("adaptive") = false,
            py::arg("aovs") = std::vector<std::string>(), py::arg("light_layer") = false);
}

}  // namespace

AovSet aov_set(const std::vector<std::string>& names) {
    AovSet set = 0;
    for (const std::string& name : names) {
        const auto aov = aov_from_name(name);
        if (!aov) throw py::value_error("no layer is called " + name);
        set |= AovSet(1) << unsigned(*aov);
    }
    return set;
}

py::dict counters_dict(const Work& work) {
    py::dict d;
    for_each_counter(work.counters, [&](std::string_view name, std::uint64_t n) {
        d[py::str(name.data(), name.size())] = n;
    });
    d["cpu_s"] = work.cpu_s;
    d["wall_s"] = work.wall_s;
    py::list rejected;
    for (const RejectionRow& row : rejection_rows(work.counters)) {
        py::dict r;
        r["material"] =
            row.material < 0 ? py::object(py::none()) : py::object(py::int_(row.material));
        r["cause"] = py::str(row.cause.data(), row.cause.size());
        r["count"] = row.count;
        rejected.append(r);
    }
    d["rejected"] = rejected;
    d["rejected_total"] = work.counters.rejected_total();
    return d;
}

py::dict error_dict(const ErrorEstimate& e) {
    const auto number = [&](double x) {
        return e.known && std::isfinite(x) ? py::object(py::float_(x)) : py::object(py::none());
    };
    py::dict d;
    const auto interval = [&](const char* lower, const char* upper, const Interval& i) {
        d[lower] = number(i.lower);
        d[upper] = number(i.upper);
    };
    const double split = look_confidence(e.look);
    d["known"] = e.known;
    d["relmse"] = number(e.relmse);
    interval("lower", "upper", relmse_interval(e));
    interval("any_time_lower", "any_time_upper", relmse_interval(e, split));
    d["rmse"] = number(e.rmse);
    const bool lit = e.rmse_percent > 0.0;
    d["rmse_percent"] = lit ? number(e.rmse_percent) : py::none();
    const Interval at_once = lit ? rmse_percent_interval(e, split) : Interval{NAN, NAN};
    const Interval alone = lit ? rmse_percent_interval(e) : Interval{NAN, NAN};
    interval("rmse_percent_lower", "rmse_percent_upper", alone);
    interval("rmse_percent_any_time_lower", "rmse_percent_any_time_upper", at_once);
    d["look"] = e.look;
    d["look_confidence"] = number(split);
    d["relmse_classic"] = number(e.relmse_classic);
    d["log_average"] = e.log_average;
    d["unknown_share"] = e.unknown_share;
    d["effective_pixels"] = number(e.effective_pixels);
    return d;
}

namespace {

py::list tile_dicts(const Film& film, int edge) {
    if (edge < 1) throw py::value_error("edge must be at least 1");
    std::vector<TileEstimate> tiles;
    {
        const py::gil_scoped_release release;
        tiles = estimate_tiles(film, edge);
    }
    py::list rows;
    for (const TileEstimate& tile : tiles) {
        py::dict d = error_dict(tile.error);
        d["x0"] = tile.x0;
        d["y0"] = tile.y0;
        d["x1"] = tile.x1;
        d["y1"] = tile.y1;
        d["mean"] = tile.error.mean;
        d["mean_standard_error"] =
            tile.error.known ? py::cast(tile.error.mean_standard_error) : py::none();
        rows.append(d);
    }
    return rows;
}

}  // namespace

void bind_film(py::module_& m) {
    m.def("student_quantile", py::vectorize(&student_quantile), py::arg("tail"), py::arg("dof"),
          "t with P(T > t) = tail, 0 < tail < 0.5.");
    m.def("student_tail", py::vectorize(&student_tail), py::arg("t"), py::arg("dof"),
          "P(T > t) for t >= 0.");
    m.def("look_confidence", &look_confidence, py::arg("look"),
          "Confidence of look k of a run: the misses of all looks sum to 5 %.");
    m.attr("CONFIDENCE") = kConfidence;
    py::list aovs;
    for (const AovInfo& info : kAovs) aovs.append(std::string(info.name));
    m.attr("AOVS") = py::tuple(aovs);
    bind_plan(m);
    bind_chunk_film(m);
    bind_film_class(m);
    py::class_<Filter>(m, "Filter", "A pixel filter, for tests and tools.")
        .def(py::init<std::string_view, float>(), py::arg("name"), py::arg("radius") = 0.0F)
        .def_property_readonly("radius", &Filter::radius)
        .def("sample", &sample_filter, py::arg("u"))
        .def("density", py::vectorize(&Filter::density), py::arg("x"));
}

}  // namespace matiere
