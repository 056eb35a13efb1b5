// The counters by name, in the order of the byte form; one list for bytes, reports and bindings.
#pragma once

#include <string_view>
#include <utility>

#include "base/guard.h"

namespace matiere {

/// Calls f(name, field) for every plain counter; the table `rejected` is handled by the caller.
template <class C, class F>
void for_each_counter(C& counters, F&& f) {
    static_assert(sizeof(Counters) == 6 * sizeof(std::uint64_t) + sizeof(Counters::rejected),
                  "a new counter must be named here");
    f(std::string_view("samples"), counters.samples);
    f(std::string_view("rays"), counters.rays);
    f(std::string_view("shadow_rays"), counters.shadow_rays);
    f(std::string_view("depth_guard"), counters.depth_guard);
    f(std::string_view("interior_overflow"), counters.interior_overflow);
    f(std::string_view("unmatched_exits"), counters.unmatched_exits);
}

}  // namespace matiere
