#include "film/film.h"

#include <algorithm>
#include <string>

#include "base/error.h"

namespace matiere {
namespace {

std::size_t sum_count(int replicates, std::size_t pixels) {
    return std::size_t(replicates) * pixels * kFilmChannels;
}

std::size_t pixel_count(int width, int height) { return std::size_t(width) * std::size_t(height); }

bool same_plan(const Plan& a, const Plan& b) {
    return a.width() == b.width() && a.height() == b.height() && a.replicates() == b.replicates();
}

std::string describe(const Plan& p) {
    return std::to_string(p.width()) + " x " + std::to_string(p.height()) + " with " +
           std::to_string(p.replicates()) + " replicates";
}

}  // namespace

ChunkFilm::ChunkFilm(const Plan& plan, std::uint32_t index)
    : plan_(plan),
      chunk_(plan.chunk(index)),
      counts_(pixel_count(chunk_.width(), chunk_.height()), 0) {
    sums_.resize(sum_count(plan.replicates(), counts_.size()), 0.0);
}

Film::Film(int width, int height, int replicates)
    : plan_(width, height, replicates),
      sums_(sum_count(replicates, pixel_count(width, height)), 0.0),
      counts_(pixel_count(width, height), 0) {}

std::uint64_t Film::tile_spp(int tile) const {
    const Chunk first = plan_.chunk(std::uint32_t(tile));
    return counts_[pixel_count(width(), first.y0) + std::size_t(first.x0)];
}

std::uint64_t Film::spp() const {
    std::uint64_t least = tile_spp(0);
    for (int tile = 1; tile < plan_.tiles(); ++tile) least = std::min(least, tile_spp(tile));
    return least;
}

std::uint32_t Film::next_chunk(int tile) const {
    return std::uint32_t(plan_.ranges(tile_spp(tile)) * std::uint64_t(plan_.tiles()) +
                         std::uint64_t(tile));
}

void Film::add(const ChunkFilm& part) {
    const Chunk& c = part.chunk();
    if (!same_plan(part.plan(), plan_))
        throw SceneError("chunk_of_another_film", "the chunk belongs to a film of " +
                                                      describe(part.plan()) + ", this one is " +
                                                      describe(plan_));
    if (merged_)
        throw SceneError("film_is_merged", "a film merged from several seeds cannot be continued");
    const std::uint32_t expected = next_chunk(int(c.index % std::uint32_t(plan_.tiles())));
    if (c.index != expected)
        throw SceneError("chunk_out_of_order", "chunk " + std::to_string(c.index) +
                                                   " was given where chunk " +
                                                   std::to_string(expected) + " is next");
    const std::size_t row_values = std::size_t(c.width()) * kFilmChannels;
    const double* from = part.sums().data();
    for (int r = 0; r < replicates(); ++r)
        for (int y = c.y0; y < c.y1; ++y) {
            const std::size_t pixel = pixel_count(width(), y) + std::size_t(c.x0);
            double* to = &sums_[(std::size_t(r) * counts_.size() + pixel) * kFilmChannels];
            for (std::size_t i = 0; i < row_values; ++i) to[i] += from[i];
            from += row_values;
        }
    const std::uint32_t* count = part.counts().data();
    for (int y = c.y0; y < c.y1; ++y)
        for (int x = c.x0; x < c.x1; ++x)
            counts_[pixel_count(width(), y) + std::size_t(x)] += *count++;
    work_ += part.work();
    provenance_ += part.provenance();
}

void Film::merge(const Film& other) {
    if (!same_plan(other.plan_, plan_))
        throw SceneError("films_do_not_match", "the other film is " + describe(other.plan_) +
                                                   ", this one is " + describe(plan_));
    for (std::size_t i = 0; i < sums_.size(); ++i) sums_[i] += other.sums_[i];
    for (std::size_t i = 0; i < counts_.size(); ++i) counts_[i] += other.counts_[i];
    work_ += other.work_;
    provenance_ += other.provenance_;
    merged_ = true;
}

}  // namespace matiere
