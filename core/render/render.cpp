#include "render/render.h"

#include <sched.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "render/fill_chunk.h"
#include "render/pass_runner.h"

namespace matiere {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

/// One call of render_passes: the state that the stop rule sees, and the log.
class Loop {
 public:
    Loop(const ChunkFunction& chunk, const Stop& stop, Film& film, int threads,
         const RenderHooks& hooks)
        : stop_(stop),
          hooks_(hooks),
          film_(film),
          runner_(chunk, film, threads),
          start_(Clock::now()),
          first_spp_(film.spp()),
          earlier_wall_s_(film.work().wall_s) {
        now_.spp = first_spp_;
        outcome_.threads = threads;
        if (now_.spp > 0) estimate();
    }

    RenderOutcome run(const CancelToken& cancel) {
        for (;;) {
            const Step step = next_step(film_.plan(), stop_, now_);
            if (!step.go_on) return finish(step.reason);
            const double before = now_.elapsed_s;
            if (!runner_.run(step.next_spp, hooks_.poll, cancel)) return finish("cancelled");
            tick(before);
            if (look_due(film_.plan(), stop_, now_.spp)) look();
            if (hooks_.progress && !hooks_.progress(progress())) return finish("callback");
        }
    }

 private:
    void tick(double before) {
        const std::uint64_t from = now_.spp;
        now_.spp = film_.spp();
        update_clock();
        outcome_.pass_s = now_.elapsed_s - before;
        // The slower of the last pass and of the whole call: late is worse than early.
        const double last = outcome_.pass_s / double(std::max<std::uint64_t>(now_.spp - from, 1));
        const double all =
            now_.elapsed_s / double(std::max<std::uint64_t>(now_.spp - first_spp_, 1));
        now_.s_per_spp = std::max(last, all);
    }

    void update_clock() {
        now_.elapsed_s = seconds_since(start_);
        film_.work().wall_s = earlier_wall_s_ + now_.elapsed_s;
    }

    void estimate() {
        outcome_.error = estimate_error(film_);
        now_.error_spp = now_.spp;
        const std::optional<double> excess = stop_.measured && hooks_.measure
                                                 ? hooks_.measure()
                                                 : target_excess(stop_, outcome_.error);
        now_.error_known = excess.has_value();
        now_.excess = excess.value_or(0.0);
    }

    void look() {
        estimate();
        update_clock();
        const Counters& c = film_.work().counters;
        outcome_.log.push_back({now_.spp, film_.work().wall_s, film_.work().cpu_s, outcome_.error,
                                c.rays + c.shadow_rays, c.rejected_total()});
    }

    RenderOutcome finish(std::string_view reason) {
        now_.spp = film_.spp();
        const bool logged = !outcome_.log.empty() && outcome_.log.back().spp == now_.spp;
        if (!logged && now_.spp > first_spp_) look();
        update_clock();
        outcome_.reason = reason;
        outcome_.wall_s = now_.elapsed_s;
        return outcome_;
    }

    Progress progress() const {
        return {now_.spp,       spp_limit(film_.plan(), stop_),
                now_.elapsed_s, seconds_left(film_.plan(), stop_, now_),
                now_.error_spp, outcome_.error};
    }

    const Stop& stop_;
    const RenderHooks& hooks_;
    Film& film_;
    PassRunner runner_;
    Clock::time_point start_;
    std::uint64_t first_spp_;
    double earlier_wall_s_;
    RenderState now_;
    RenderOutcome outcome_;
};

}  // namespace

int available_threads() {
    cpu_set_t set;
    CPU_ZERO(&set);
    if (sched_getaffinity(0, sizeof set, &set) == 0) return std::max(CPU_COUNT(&set), 1);
    return std::max(int(std::thread::hardware_concurrency()), 1);
}

RenderOutcome render_passes(const ChunkFunction& chunk, const Stop& stop, Film& film, int threads,
                            const RenderHooks& hooks, const CancelToken& cancel) {
    const int count = threads > 0 ? threads : available_threads();
    return Loop(chunk, stop, film, count, hooks).run(cancel);
}

}  // namespace matiere
