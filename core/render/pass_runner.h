// The threads of the pass loop. They live for one render; each takes the next chunk in plan order
// and folds it into the film. A strip (tile, or tile and half) may have several chunks in a pass of
// an adaptive film: one that is done before its forerunner waits, so the fold order is fixed.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "base/parallel.h"
#include "film/film.h"
#include "render/render.h"

namespace matiere {

class PassRunner {
 public:
    PassRunner(const ChunkFunction& chunk, Film& film, int threads);
    ~PassRunner();
    PassRunner(const PassRunner&) = delete;
    PassRunner& operator=(const PassRunner&) = delete;

    /// Renders every chunk that tiles lack up to `spp`. False if `cancel` was raised; rethrows what
    /// a worker or `poll` threw. Every thread is idle again when it returns.
    bool run(std::uint64_t spp, const std::function<void()>& poll, const CancelToken& cancel);

 private:
    using Clock = std::chrono::steady_clock;

    void work();
    void shut_down();
    bool take(std::uint32_t& index);
    void finish(std::optional<ChunkFilm> done, std::exception_ptr error);
    void fold(ChunkFilm done);
    /// Of chunks with a light layer: the done one that comes next in the plan.
    std::map<std::uint32_t, ChunkFilm>::iterator next_early();
    bool run_queue(const std::function<void()>& poll, const CancelToken& cancel);
    void wait(const std::function<void()>& poll, const CancelToken& cancel);

    const ChunkFunction& chunk_;
    Film& film_;
    std::mutex mutex_;
    std::condition_variable work_ready_, pass_done_;
    std::vector<std::uint32_t> queue_;          ///< chunks of this pass, in order
    std::size_t next_ = 0;                      ///< first chunk nobody took
    std::size_t open_ = 0;                      ///< chunks taken and not finished
    std::map<std::uint32_t, ChunkFilm> early_;  ///< done before the chunk they follow
    bool closing_ = false;
    Clock::time_point last_poll_ = Clock::now();
    std::exception_ptr error_;
    CancelToken abort_;
    std::vector<std::thread> threads_;
};

}  // namespace matiere
