#include "render/pass_runner.h"

#include <algorithm>
#include <utility>

namespace matiere {
namespace {

constexpr std::chrono::milliseconds kPollInterval{20};

}  // namespace

PassRunner::PassRunner(const ChunkFunction& chunk, Film& film, int threads)
    : chunk_(chunk), film_(film) {
    threads_.reserve(std::size_t(threads));
    try {
        for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { work(); });
    } catch (...) {  // the system gives no more threads: a joinable one must not be destroyed
        shut_down();
        throw;
    }
}

PassRunner::~PassRunner() { shut_down(); }

void PassRunner::shut_down() {
    {
        const std::lock_guard lock(mutex_);
        closing_ = true;
        next_ = queue_.size();
    }
    abort_.cancel();
    work_ready_.notify_all();
    for (auto& t : threads_) t.join();
}

bool PassRunner::run(std::uint64_t spp, const std::function<void()>& poll,
                     const CancelToken& cancel) {
    for (;;) {  // an adaptive film may decide on more when its queue is done
        {
            const std::lock_guard lock(mutex_);
            queue_ = film_.missing(spp);
            next_ = 0;
            early_.clear();
            if (queue_.empty()) return true;
        }
        if (!run_queue(poll, cancel)) return false;
    }
}

bool PassRunner::run_queue(const std::function<void()>& poll, const CancelToken& cancel) {
    work_ready_.notify_all();
    try {
        wait(poll, cancel);
    } catch (...) {
        abort_.cancel();
        wait({}, CancelToken{});
        throw;
    }
    if (error_) std::rethrow_exception(error_);
    return !abort_.cancelled();
}

/// Until no chunk is waiting or in the making. Short passes end without a poll in between, so that
/// they need not wait for Python's lock; the clock runs on from pass to pass.
void PassRunner::wait(const std::function<void()>& poll, const CancelToken& cancel) {
    std::unique_lock lock(mutex_);
    for (;;) {
        if (abort_.cancelled()) next_ = queue_.size();
        const bool done = next_ == queue_.size() && open_ == 0;
        const bool due = Clock::now() - last_poll_ >= kPollInterval;
        if (due) {
            lock.unlock();
            if (cancel.cancelled()) abort_.cancel();
            if (poll) poll();
            last_poll_ = Clock::now();
            lock.lock();
        }
        if (done) return;
        if (!due) pass_done_.wait_for(lock, kPollInterval);
    }
}

bool PassRunner::take(std::uint32_t& index) {
    std::unique_lock lock(mutex_);
    work_ready_.wait(lock, [this] { return closing_ || next_ < queue_.size(); });
    if (closing_) return false;
    index = queue_[next_++];
    ++open_;
    return true;
}

void PassRunner::fold(ChunkFilm done) {
    const auto strips = std::uint32_t(film_.plan().strips());
    std::uint32_t index = done.chunk().index;
    const bool in_plan_order = done.has_splats();
    early_.emplace(index, std::move(done));
    if (in_plan_order) {
        for (auto at = next_early(); at != early_.end(); at = next_early()) {
            film_.add(at->second);
            early_.erase(at);
        }
        return;
    }
    if (index != film_.next_chunk(int(index % strips))) return;
    for (auto at = early_.find(index); at != early_.end(); at = early_.find(index += strips)) {
        film_.add(at->second);
        early_.erase(at);
    }
}

std::map<std::uint32_t, ChunkFilm>::iterator PassRunner::next_early() {
    return std::find_if(early_.begin(), early_.end(),
                        [this](const auto& chunk) { return film_.in_order(chunk.first); });
}

void PassRunner::finish(std::optional<ChunkFilm> done, std::exception_ptr error) {
    const std::lock_guard lock(mutex_);
    try {
        if (done) fold(std::move(*done));
    } catch (...) {
        error = std::current_exception();
    }
    if (error && !error_) error_ = std::move(error);
    if (error_) abort_.cancel();
    if (--open_ == 0) pass_done_.notify_all();
}

void PassRunner::work() {
    std::uint32_t index = 0;
    while (take(index)) {
        std::optional<ChunkFilm> done;
        std::exception_ptr error;
        try {
            done = chunk_(index, abort_);
        } catch (...) {
            error = std::current_exception();
        }
        finish(std::move(done), error);
    }
}

}  // namespace matiere
