#include "film/adaptive_state.h"

#include <algorithm>
#include <utility>

#include "film/film.h"
#include "film/worth.h"

namespace matiere {

bool AdaptiveState::wants(std::uint32_t index, const Plan& plan) const {
    const auto strip = int(index % std::uint32_t(plan.strips()));
    const std::uint64_t range = index / std::uint32_t(plan.strips());
    return range == ranges(strip) && range < allocation_.planned(strip);
}

std::vector<std::uint32_t> AdaptiveState::missing(std::uint64_t k, const Plan& plan) const {
    std::vector<std::uint32_t> found;
    for (std::size_t i = done_; i < allocation_.round_end(k); ++i) {
        const std::uint32_t index = allocation_.order()[i];
        const auto strips = std::uint32_t(plan.strips());
        if (index / strips >= ranges(int(index % strips))) found.push_back(index);
    }
    return found;
}

void AdaptiveState::note(const Film& film, const Chunk& chunk, std::uint64_t rays) {
    const Plan& plan = film.plan();
    const auto strip = int(chunk.index % std::uint32_t(plan.strips()));
    ++ranges_[std::size_t(strip)];
    rays_[std::size_t(strip)] += rays;
    for (int level = 1; allocation_.base(level) <= ranges(strip); ++level)
        if (allocation_.base(level) == ranges(strip)) {
            measure(film, strip, level);
            break;
        }
    advance(plan);
    if (done_ < allocation_.order().size()) return;
    if (allocation_.level() == 0) take_pilot(film);
    while (done_ == allocation_.order().size()) {
        if (!allocation_.decide({worth(allocation_.level()), ranges_.size()})) return;
        advance(plan);
    }
}

void AdaptiveState::advance(const Plan& plan) {
    const auto strips = std::uint32_t(plan.strips());
    const auto order = allocation_.order();
    while (done_ < order.size() && order[done_] / strips < ranges(int(order[done_] % strips)))
        ++done_;
}

double* AdaptiveState::worth(int level) {
    const std::size_t end = std::size_t(level + 1) * ranges_.size();
    if (worth_.size() < end) worth_.resize(end, 0.0);
    return &worth_[end - ranges_.size()];
}

void AdaptiveState::measure(const Film& film, int strip, int level) {
    const int half = strip / film.plan().tiles();
    worth(level)[strip] =
        strip_worth(film, strip, floors_[std::size_t(half)], rays_[std::size_t(strip)]);
}

/// All tiles have just the first base: what is dark in this image, and what its tiles are worth.
void AdaptiveState::take_pilot(const Film& film) {
    for (int half = 0; half < 2; ++half) floors_[std::size_t(half)] = half_floor(film, half);
    for (int strip = 0; strip < film.plan().strips(); ++strip) measure(film, strip, 0);
}

bool AdaptiveState::restore(const Film& film, const std::vector<std::uint64_t>& ranges,
                            Record record) {
    const Plan& plan = film.plan();
    if (record.rays.size() != rays_.size() || record.worth.size() % rays_.size() != 0) return false;
    ranges_ = ranges;
    floors_ = record.floors;
    worth_ = std::move(record.worth);
    rays_ = std::move(record.rays);
    for (advance(plan); done_ == allocation_.order().size(); advance(plan)) {
        const auto level = std::size_t(allocation_.level());
        if ((level + 1) * rays_.size() > worth_.size()) return false;
        if (!allocation_.decide({worth(int(level)), ranges_.size()})) break;
    }
    for (int strip = 0; strip < plan.strips(); ++strip)
        if (this->ranges(strip) > allocation_.planned(strip)) return false;
    return true;
}

}  // namespace matiere
