// The film: per pixel and replicate four double sums (linear R, G, B, alpha), and what it cost.
// Chunks are added tile by tile in plan order as a left fold in double, so the sums of a given spp
// have the same bits for any number of threads, processes, kills and restarts. In an adaptive film
// the halves of the replicates have sample counts of their own and each is averaged by itself.
// A film may have a second layer of light that paths from the lights brought (splats.h): sums of
// three colours per pixel and replicate, over the paths of a replicate. Its chunks are added in
// plan order, whatever the tile, as a light path may reach any pixel.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/guard.h"
#include "film/adaptive_state.h"
#include "film/aov.h"
#include "film/cut_energy.h"
#include "film/outliers.h"
#include "film/plan.h"
#include "film/splats.h"

namespace matiere {

inline constexpr int kFilmChannels = 4;  ///< R, G, B, alpha

/// What rendering cost; summed with the samples, no part of their bits.
struct Work {
    Counters counters;
    double cpu_s = 0.0;   ///< thread CPU clock
    double wall_s = 0.0;  ///< pass loop only: chunks do not know it

    Work& operator+=(const Work& b) {
        counters += b.counters;
        cpu_s += b.cpu_s;
        wall_s += b.wall_s;
        return *this;
    }
};

/// The sums of one chunk, starting from zero.
class ChunkFilm {
 public:
    ChunkFilm(const Plan& plan, std::uint32_t index, AovSet aovs = 0);

    const Plan& plan() const { return plan_; }
    const Chunk& chunk() const { return chunk_; }
    Work& work() { return work_; }
    const Work& work() const { return work_; }
    Provenance& provenance() { return provenance_; }
    const Provenance& provenance() const { return provenance_; }
    Cuts& cuts() { return cuts_; }
    const Cuts& cuts() const { return cuts_; }

    /// Adds sample s (of the chunk's range and replicates) of the pixel at (x, y) inside the tile.
    void add(int x, int y, std::uint64_t s, const double (&value)[kFilmChannels]) {
        const auto r = std::size_t(s % std::uint64_t(plan_.replicates())) - std::size_t(chunk_.r0);
        const std::size_t pixel = std::size_t(y) * std::size_t(chunk_.width()) + std::size_t(x);
        double* sum = &sums_[(r * counts_.size() + pixel) * kFilmChannels];
        for (int c = 0; c < kFilmChannels; ++c) sum[c] += value[c];
        ++counts_[pixel];
    }

    /// Adds what sample s says of the layers; beside `add`.
    void add_aovs(int x, int y, std::uint64_t s, const AovSample& sample) {
        const std::size_t pixel = std::size_t(y) * std::size_t(chunk_.width()) + std::size_t(x);
        layout_.add(sample, s == 0, &aovs_[pixel * std::size_t(layout_.channels())]);
    }

    std::span<const double> sums() const { return sums_; }  ///< [r - r0][y][x][channel]
    std::span<const std::uint32_t> counts() const { return counts_; }
    const AovLayout& layout() const { return layout_; }
    std::span<const double> aovs() const { return aovs_; }  ///< [y][x][channel of the layout]

    /// Begins the light layer: `paths` of every replicate belong to this chunk.
    void begin_splats(std::uint64_t paths);
    bool has_splats() const { return !splats_.empty(); }
    /// [r - r0]; where the film tells lobes apart, then what of all came by diffuse lobes, and what
    /// by transmission.
    std::vector<SplatSums>& splats() { return splats_; }
    const std::vector<SplatSums>& splats() const { return splats_; }
    std::uint64_t light_paths() const { return light_paths_; }  ///< of each replicate

    /// Self-describing little-endian bytes with a CRC-64 at the end.
    std::vector<std::byte> to_bytes() const;
    /// Throws SceneError in words when the bytes are damaged, cut short or of another version.
    static ChunkFilm from_bytes(std::span<const std::byte> bytes);

 private:
    Plan plan_;
    Chunk chunk_;
    AovLayout layout_;
    std::vector<double> sums_, aovs_;
    std::vector<std::uint32_t> counts_;
    std::vector<SplatSums> splats_;
    std::uint64_t light_paths_ = 0;
    Work work_;
    Provenance provenance_;
    Cuts cuts_;
};

class Film {
 public:
    Film(int width, int height, int replicates, bool adaptive = false)
        : Film(Plan(width, height, replicates, adaptive)) {}
    explicit Film(const Plan& plan);

    const Plan& plan() const { return plan_; }
    int width() const { return plan_.width(); }
    int height() const { return plan_.height(); }
    int replicates() const { return plan_.replicates(); }
    std::size_t pixels() const { return counts_.size(); }
    Work& work() { return work_; }
    const Work& work() const { return work_; }
    const Provenance& provenance() const { return provenance_; }
    /// What a depth limit or a threshold cut off, over all pixels alike.
    CutEnergy cut_energy(Cut cause) const;
    /// True when films of several seeds were merged: no chunk can follow.
    bool merged() const { return merged_; }

    /// Samples every pixel has at least; of an adaptive film the boundary that the mean has
    /// reached.
    std::uint64_t spp() const;
    /// Index of the next chunk of this strip: a tile, or a tile and half of an adaptive film.
    std::uint32_t next_chunk(int strip) const;
    /// Chunks to be added next on the way to `spp`: all of them, or of an adaptive film those that
    /// are decided. Empty when the film is there.
    std::vector<std::uint32_t> missing(std::uint64_t spp) const;
    /// Adds the next chunk of a strip, of a film with a light layer the next of all; throws
    /// SceneError for any other chunk, leaving the film as is.
    void add(const ChunkFilm& chunk);
    /// Adds a film of other seeds, replicate by replicate: the replicates stay independent and
    /// alike. Sizes and replicates must agree. The caller vouches that no seed occurs twice.
    void merge(const Film& other);

    std::span<const double> sums() const { return sums_; }  ///< [replicate][y][x][channel]
    std::span<double> sums() { return sums_; }
    std::span<const std::uint32_t> counts() const { return counts_; }  ///< [y][x]
    /// Of an adaptive film the samples in the first half of the replicates, [y][x]; else empty.
    std::span<const std::uint32_t> first_counts() const { return first_counts_; }
    /// Samples of a pixel in the replicates that share a count with r: a half, or all.
    std::uint32_t count(std::size_t pixel, int r) const {
        if (first_counts_.empty()) return counts_[pixel];
        const std::uint32_t first = first_counts_[pixel];
        return r < replicates() / 2 ? first : counts_[pixel] - first;
    }
    /// Whether paths from the lights took part.
    bool has_light_layer() const { return !light_sums_.empty(); }
    std::span<const double> light_sums() const {  ///< [replicate][y][x][c]
        const auto size = std::size_t(replicates()) * counts_.size() * kSplatChannels;
        return std::span(light_sums_).first(has_light_layer() ? size : 0);
    }
    /// Light paths of each replicate of a half; halves are alike but in an adaptive film.
    std::uint64_t light_paths(int half = 0) const { return light_paths_[std::size_t(half)]; }
    /// Whether `index` may be added now as far as the order of a light layer is concerned.
    bool in_order(std::uint32_t index) const;

    /// What is decided about the samples to come; nothing but in an adaptive film of one seed.
    const std::optional<AdaptiveState>& adaptive() const { return adaptive_; }

    /// Mean of one replicate, or of all with r = -1; zeros where there is no sample. The halves of
    /// an adaptive film weigh the same whatever their counts.
    double mean(std::size_t pixel, int channel, int r) const {
        const double camera = camera_mean(pixel, channel, r);
        return has_light_layer() ? camera + light_mean(pixel, channel, r) : camera;
    }
    /// The light layer's part of the mean.
    double light_mean(std::size_t pixel, int channel, int r) const {
        if (!has_light_layer() || channel >= kSplatChannels) return 0.0;
        if (r >= 0) {
            const auto n = double(light_paths(plan_.adaptive() && r >= replicates() / 2 ? 1 : 0));
            return n == 0.0 ? 0.0 : light_plane(r, pixel, channel) / n;
        }
        double total = 0.0;
        for (int i = 0; i < replicates(); ++i) total += light_mean(pixel, channel, i);
        return total / double(replicates());
    }
    /// The camera paths' part of the mean.
    double camera_mean(std::size_t pixel, int channel, int r) const {
        const int share = replicates() / plan_.halves();
        if (r >= 0) {
            const double n = double(count(pixel, r));
            return n == 0.0 ? 0.0 : sum(r, pixel, channel) * double(share) / n;
        }
        double result = 0.0;
        for (int first = 0; first < replicates(); first += share) {
            const double n = double(count(pixel, first));
            if (n == 0.0) return 0.0;
            double total = 0.0;
            for (int i = first; i < first + share; ++i) total += sum(i, pixel, channel);
            result += total / n;
        }
        return plan_.adaptive() ? 0.5 * result : result;
    }

    /// Layers beside the light; an empty film takes those of its first chunk.
    const AovLayout& layout() const { return layout_; }
    /// Mean of a layer, [y][x][channel]; where nothing was met material_id
    /// is -1, depth infinite, position and uv NaN.
    std::vector<double> aov(Aov aov) const;

    std::vector<std::byte> to_bytes() const;
    static Film from_bytes(std::span<const std::byte> bytes);

    static std::size_t bytes_per_pixel(int replicates, bool adaptive = false, AovSet aovs = 0,
                                       bool light_layer = false) {
        const int planes = light_layer ? light_planes(replicates, adaptive ? 2 : 1, aovs) : 0;
        const int values = replicates * kFilmChannels + planes * kSplatChannels +
                           AovLayout(aovs).channels() * (adaptive ? 2 : 1);
        return std::size_t(values) * sizeof(double) + (adaptive ? 2 : 1) * sizeof(std::uint32_t);
    }

 private:
    double sum(int r, std::size_t pixel, int channel) const {
        return sums_[(std::size_t(r) * counts_.size() + pixel) * kFilmChannels +
                     std::size_t(channel)];
    }
    std::uint64_t strip_spp(int strip) const;
    void add_sums(const ChunkFilm& part);
    void add_aovs(const ChunkFilm& part);
    void set_layers(AovSet aovs);
    double aov_sum(int half, std::size_t pixel, int channel) const {
        const auto channels = std::size_t(layout_.channels());
        return aovs_[(std::size_t(half) * counts_.size() + pixel) * channels +
                     std::size_t(channel)];
    }
    /// Planes of the light layer: the replicates, then two of lobes for each half.
    static int light_planes(int replicates, int halves, AovSet aovs) {
        return replicates + (AovLayout(aovs).has_lobes() ? kSplatLobes * halves : 0);
    }
    double light_plane(int plane, std::size_t pixel, int channel) const {
        const auto at = std::size_t(plane) * counts_.size() + pixel;
        return light_sums_[at * kSplatChannels + std::size_t(channel)];
    }
    double light_lobe(int lobe, std::size_t pixel, int channel) const;
    double light_of(Aov aov, std::size_t pixel, int channel) const;
    void check(const ChunkFilm& part) const;
    void add_splats(const ChunkFilm& part);
    bool empty() const;
    void check_counts() const;
    void restore(AdaptiveState::Record record);

    Plan plan_;
    AovLayout layout_;
    std::vector<double> sums_;
    std::vector<double> aovs_;  ///< [half of the replicates][y][x][channel of the layout]
    std::vector<std::uint32_t> counts_, first_counts_;
    std::vector<double> light_sums_;              ///< [plane][y][x][c], see light_planes
    std::array<std::uint64_t, 2> light_paths_{};  ///< by half
    std::optional<AdaptiveState> adaptive_;
    Work work_;
    Provenance provenance_;
    std::vector<Cuts> cuts_;  // by strip: an adaptive film's have sample counts of their own
    bool merged_ = false;
};

}  // namespace matiere
