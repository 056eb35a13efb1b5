#include "film/film.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "base/error.h"

namespace matiere {
namespace {

std::size_t sum_count(int replicates, std::size_t pixels) {
    return std::size_t(replicates) * pixels * kFilmChannels;
}

std::size_t pixel_count(int width, int height) { return std::size_t(width) * std::size_t(height); }

std::string describe(const Plan& p) {
    return std::to_string(p.width()) + " x " + std::to_string(p.height()) + " with " +
           std::to_string(p.replicates()) + (p.adaptive() ? " adaptive" : "") + " replicates";
}

}  // namespace

ChunkFilm::ChunkFilm(const Plan& plan, std::uint32_t index, AovSet aovs)
    : plan_(plan),
      chunk_(plan.chunk(index)),
      layout_(aovs),
      counts_(pixel_count(chunk_.width(), chunk_.height()), 0) {
    sums_.resize(sum_count(chunk_.replicates(), counts_.size()), 0.0);
    aovs_.resize(counts_.size() * std::size_t(layout_.channels()), 0.0);
}

Film::Film(const Plan& plan)
    : plan_(plan),
      sums_(sum_count(plan.replicates(), pixel_count(plan.width(), plan.height())), 0.0),
      counts_(pixel_count(plan.width(), plan.height()), 0),
      cuts_(std::size_t(plan.strips())) {
    if (!plan.adaptive()) return;
    first_counts_.resize(counts_.size(), 0);
    adaptive_.emplace(plan);
}

/// What every pixel of the film would have if all strips were as far as this one.
std::uint64_t Film::strip_spp(int strip) const {
    const Chunk first = plan_.chunk(std::uint32_t(strip));
    const std::size_t pixel = pixel_count(width(), first.y0) + std::size_t(first.x0);
    return std::uint64_t(plan_.halves()) * count(pixel, first.r0);
}

std::uint64_t Film::spp() const {
    if (adaptive_) return plan_.boundary(adaptive_->rounds());
    if (plan_.adaptive()) {  // merged: no boundary is there to name
        const std::uint64_t total = std::accumulate(counts_.begin(), counts_.end(), 0ULL);
        return total / counts_.size();
    }
    std::uint64_t least = strip_spp(0);
    for (int tile = 1; tile < plan_.tiles(); ++tile) least = std::min(least, strip_spp(tile));
    return least;
}

std::uint32_t Film::next_chunk(int strip) const {
    return std::uint32_t(plan_.ranges(strip_spp(strip)) * std::uint64_t(plan_.strips()) +
                         std::uint64_t(strip));
}

std::vector<std::uint32_t> Film::missing(std::uint64_t spp) const {
    if (adaptive_) return adaptive_->missing(plan_.ranges(spp), plan_);
    std::vector<std::uint32_t> found;
    for (int tile = 0; tile < plan_.tiles(); ++tile)
        if (const std::uint32_t index = next_chunk(tile); plan_.chunk(index).s1 <= spp)
            found.push_back(index);
    return found;
}

void ChunkFilm::begin_splats(std::uint64_t paths) {
    splats_.resize(std::size_t(chunk_.replicates()) + (layout_.has_lobes() ? kSplatLobes : 0));
    light_paths_ = paths;
}

/// Throws unless the chunk is the one that comes next.
void Film::check(const ChunkFilm& part) const {
    const std::uint32_t index = part.chunk().index;
    const auto refuse = [](const char* code, const std::string& why) {
        throw SceneError(code, why);
    };
    const std::string chunk = "chunk " + std::to_string(index);
    if (part.plan() != plan_)
        refuse("chunk_of_another_film", "the chunk belongs to a film of " + describe(part.plan()) +
                                            ", this one is " + describe(plan_));
    if (merged_) refuse("film_is_merged", "a film merged from several seeds cannot be continued");
    const std::uint32_t expected = next_chunk(int(index % std::uint32_t(plan_.strips())));
    if (adaptive_ && index == expected && !adaptive_->wants(index, plan_))
        refuse("chunk_out_of_order", chunk + " was given before its tile's turn");
    if (index != expected)
        refuse("chunk_out_of_order",
               chunk + " was given where chunk " + std::to_string(expected) + " is next");
    if (part.layout().set() != layout_.set() && !empty())
        refuse("chunk_of_another_film",
               "the chunk has other layers than the film: render both with the same film.aovs");
    if (part.has_splats() != has_light_layer() && !empty())
        refuse("chunk_of_another_film",
               "the chunk has light of paths from the lights and the film has none, or the other "
               "way round");
    if (part.has_splats() && !in_order(index))
        refuse("chunk_out_of_order",
               chunk +
                   " was given before its turn: chunks with a light layer are added in plan "
                   "order");
}

void Film::add(const ChunkFilm& part) {
    check(part);
    const Chunk& c = part.chunk();
    if (part.layout().set() != layout_.set()) set_layers(part.layout().set());
    add_sums(part);
    add_aovs(part);
    if (part.has_splats()) add_splats(part);
    work_ += part.work();
    provenance_ += part.provenance();
    Cuts& cuts = cuts_[c.index % std::uint32_t(plan_.strips())];
    for (std::size_t i = 0; i < cuts.size(); ++i) cuts[i] += part.cuts()[i];
    if (!adaptive_) return;
    const Counters& cost = part.work().counters;
    adaptive_->note(*this, c, cost.rays + cost.shadow_rays);
}

void Film::add_sums(const ChunkFilm& part) {
    const Chunk& c = part.chunk();
    const std::size_t row_values = std::size_t(c.width()) * kFilmChannels;
    const double* from = part.sums().data();
    for (int r = c.r0; r < c.r1; ++r)
        for (int y = c.y0; y < c.y1; ++y) {
            const std::size_t pixel = pixel_count(width(), y) + std::size_t(c.x0);
            double* to = &sums_[(std::size_t(r) * counts_.size() + pixel) * kFilmChannels];
            for (std::size_t i = 0; i < row_values; ++i) to[i] += from[i];
            from += row_values;
        }
    const std::uint32_t* count = part.counts().data();
    for (int y = c.y0; y < c.y1; ++y)
        for (int x = c.x0; x < c.x1; ++x, ++count) {
            const std::size_t pixel = pixel_count(width(), y) + std::size_t(x);
            counts_[pixel] += *count;
            if (plan_.adaptive() && c.r0 == 0) first_counts_[pixel] += *count;
        }
}

/// Strip by strip: the mean over its samples weighs as much as its pixels do. The samples of a
/// strip are taken as independent, which is on the safe side: those of a pixel are spread more
/// evenly.
CutEnergy Film::cut_energy(Cut cause) const {
    CutEnergy energy;
    std::array<double, 3> variance{};
    const double weighed = double(plan_.halves()) * double(pixels());
    for (int strip = 0; strip < plan_.strips(); ++strip) {
        const CutSums& sums = cuts_[std::size_t(strip)][std::size_t(cause) - 1];
        const Chunk c = plan_.chunk(std::uint32_t(strip));
        const double spp = double(strip_spp(strip)) / double(plan_.halves());
        const double n = spp * double(c.width()) * double(c.height());
        energy.paths += sums.paths;
        energy.followed += sums.followed;
        if (n < 2) continue;
        for (std::size_t k = 0; k < 3; ++k) {
            energy.radiance[k] += sums.light[k] / (spp * weighed);
            const double spread = sums.squares[k] - sums.light[k] * sums.light[k] / n;
            variance[k] += spread * n / (n - 1) / ((spp * weighed) * (spp * weighed));
        }
    }
    for (std::size_t k = 0; k < 3; ++k)
        energy.standard_error[k] = std::sqrt(std::max(variance[k], 0.0));
    return energy;
}

void Film::set_layers(AovSet aovs) {
    layout_ = AovLayout(aovs);
    aovs_.assign(std::size_t(plan_.halves()) * counts_.size() * std::size_t(layout_.channels()),
                 0.0);
}

void Film::add_aovs(const ChunkFilm& part) {
    const Chunk& c = part.chunk();
    const auto channels = std::size_t(layout_.channels());
    const std::size_t row_values = std::size_t(c.width()) * channels;
    const double* from = part.aovs().data();
    const std::size_t half = c.r0 == 0 ? 0 : counts_.size();
    for (int y = c.y0; y < c.y1 && channels > 0; ++y, from += row_values) {
        double* to = &aovs_[(half + pixel_count(width(), y) + std::size_t(c.x0)) * channels];
        for (std::size_t i = 0; i < row_values; ++i) to[i] += from[i];
    }
}

std::vector<double> Film::aov(Aov aov) const {
    if (!layout_.has(aov))
        throw SceneError("no_layer", "the film has no layer '" +
                                         std::string(kAovs[std::size_t(aov)].name) + "'");
    const AovInfo& info = kAovs[std::size_t(aov)];
    const auto channels = std::size_t(info.channels);
    std::vector<double> out(counts_.size() * channels, 0.0);
    const int share = replicates() / plan_.halves();
    for (std::size_t pixel = 0; pixel < counts_.size(); ++pixel) {
        double* to = &out[pixel * channels];
        if (info.mean == AovMean::kFirst) {
            *to = aov_sum(0, pixel, layout_.offset(aov)) - 1.0;
            continue;
        }
        double met = 0.0;  // the halves of an adaptive film weigh the same
        for (int half = 0; half < plan_.halves(); ++half) {
            const double n = double(count(pixel, half * share)) * double(plan_.halves());
            if (n == 0.0) continue;
            met += aov_sum(half, pixel, layout_.met()) / n;
            for (int c = 0; c < info.channels; ++c)
                to[c] += aov_sum(half, pixel, layout_.offset(aov) + c) / n;
        }
        for (int c = 0; c < info.channels && has_light_layer(); ++c)
            to[c] += light_of(aov, pixel, c);
        if (info.mean == AovMean::kSamples) continue;
        using Limits = std::numeric_limits<double>;
        const double nothing = aov == Aov::kDepth ? Limits::infinity() : Limits::quiet_NaN();
        for (std::size_t c = 0; c < channels; ++c) to[c] = met > 0.0 ? to[c] / met : nothing;
    }
    return out;
}

bool Film::empty() const {
    return std::all_of(counts_.begin(), counts_.end(), [](std::uint32_t n) { return n == 0; });
}

bool Film::in_order(std::uint32_t index) const {
    if (adaptive_) return adaptive_->is_next(index);
    const auto strips = std::uint32_t(plan_.strips());
    const auto is_here = [&](std::uint32_t i) { return next_chunk(int(i % strips)) > i; };
    return !is_here(index) && (index == 0 || is_here(index - 1));
}

void Film::add_splats(const ChunkFilm& part) {
    const Chunk& c = part.chunk();
    const int planes = light_planes(replicates(), plan_.halves(), layout_.set());
    if (light_sums_.empty())
        light_sums_.resize(std::size_t(planes) * counts_.size() * kSplatChannels, 0.0);
    const int half = c.r0 == 0 ? 0 : 1;
    light_paths_[std::size_t(half)] += part.light_paths();
    for (std::size_t k = 0; k < part.splats().size(); ++k) {
        const int lobe = int(k) - c.replicates();
        const int plane = lobe < 0 ? c.r0 + int(k) : replicates() + half * kSplatLobes + lobe;
        const SplatSums& from = part.splats()[k];
        for (std::size_t i = 0; i < from.pixels().size(); ++i) {
            const auto at = std::size_t(plane) * counts_.size() + from.pixels()[i];
            for (std::size_t ch = 0; ch < kSplatChannels; ++ch)
                light_sums_[at * kSplatChannels + ch] += from.sums()[i][ch];
        }
    }
}

/// Mean of what came by diffuse lobes (0) or transmission (1); the halves of an adaptive film weigh
/// the same.
double Film::light_lobe(int lobe, std::size_t pixel, int channel) const {
    double total = 0.0;
    for (int half = 0; half < plan_.halves(); ++half) {
        const auto n = double(light_paths(half)) * double(replicates());
        const int plane = replicates() + half * kSplatLobes + lobe;
        if (n > 0.0) total += light_plane(plane, pixel, channel) / n;
    }
    return total;
}

/// The light layer's part of a layer of the film: it is all indirect.
double Film::light_of(Aov aov, std::size_t pixel, int channel) const {
    switch (aov) {
        case Aov::kIndirect:
            return light_mean(pixel, channel, -1);
        case Aov::kDiffuse:
            return light_lobe(0, pixel, channel);
        case Aov::kTransmission:
            return light_lobe(1, pixel, channel);
        case Aov::kSpecular:
            return std::max(light_mean(pixel, channel, -1) - light_lobe(0, pixel, channel) -
                                light_lobe(1, pixel, channel),
                            0.0);
        default:
            return 0.0;
    }
}

void Film::merge(const Film& other) {
    if (other.plan_ != plan_)
        throw SceneError("films_do_not_match", "the other film is " + describe(other.plan_) +
                                                   ", this one is " + describe(plan_));
    if (other.layout_.set() != layout_.set())
        throw SceneError("films_do_not_match", "the films have other layers beside the light");
    if (other.has_light_layer() != has_light_layer())
        throw SceneError("films_do_not_match", "one film has light of paths from the lights");
    for (std::size_t i = 0; i < light_sums_.size(); ++i) light_sums_[i] += other.light_sums_[i];
    for (std::size_t h = 0; h < light_paths_.size(); ++h) light_paths_[h] += other.light_paths_[h];
    for (std::size_t i = 0; i < sums_.size(); ++i) sums_[i] += other.sums_[i];
    const auto channels = std::size_t(layout_.channels());
    for (std::size_t i = 0; i < aovs_.size(); ++i)  // the first film's first sample stays
        if (!layout_.has(Aov::kMaterialId) ||
            i % channels != std::size_t(layout_.offset(Aov::kMaterialId)))
            aovs_[i] += other.aovs_[i];
    for (std::size_t i = 0; i < counts_.size(); ++i) counts_[i] += other.counts_[i];
    for (std::size_t i = 0; i < first_counts_.size(); ++i)
        first_counts_[i] += other.first_counts_[i];
    adaptive_.reset();
    work_ += other.work_;
    provenance_ += other.provenance_;
    for (std::size_t s = 0; s < cuts_.size(); ++s)
        for (std::size_t i = 0; i < cuts_[s].size(); ++i) cuts_[s][i] += other.cuts_[s][i];
    merged_ = true;
}

}  // namespace matiere
