// Cancellation and the floating-point mode of render threads.
#pragma once

#include <atomic>

#include <immintrin.h>

namespace matiere {

/// A flag that any thread may raise; render loops poll it once per tile row.
class CancelToken {
 public:
    void cancel() { flag_.store(true, std::memory_order_relaxed); }
    bool cancelled() const { return flag_.load(std::memory_order_relaxed); }

 private:
    std::atomic<bool> flag_{false};
};

/// Flush-to-zero and denormals-are-zero for the current thread, as Embree asks; the old mode comes
/// back at the end of the scope, so that a caller's numpy keeps its denormals.
class FlushDenormals {
 public:
    FlushDenormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | kFtz | kDaz); }
    ~FlushDenormals() { _mm_setcsr(saved_); }
    FlushDenormals(const FlushDenormals&) = delete;
    FlushDenormals& operator=(const FlushDenormals&) = delete;

 private:
    static constexpr unsigned kFtz = 0x8000, kDaz = 0x0040;
    unsigned saved_;
};

}  // namespace matiere
