// Which media a path is inside of: a fixed stack of (material, priority), so that closed dielectric
// shapes may overlap and nest (Schmidt & Budge 2002, "Simple Nested Dielectrics in Ray Traced
// Images").
#pragma once

#include <array>
#include <cstddef>

#include "base/guard.h"
#include "material/material.h"

namespace matiere {

class InteriorStack {
 public:
    static constexpr std::size_t kCapacity = 8;

    bool empty() const { return size_ == 0; }

    /// Material of the medium at this point: the highest priority, the newest among equals; -1 is
    /// the vacuum outside of everything.
    int current() const { return best(kNone, true); }

    /// The medium that refracts once `material` (its newest entry) is taken away, -1 takes nothing:
    /// one without an index of its own leaves that to what it lies in.
    int refracting_without(int material) const { return best(newest(material), false); }

    void enter(int material, const MaterialRecord& record, Counters& counters) {
        if (size_ == kCapacity) {
            ++counters.interior_overflow;
            return;
        }
        entries_[size_++] = {material, record.priority, record.matched};
    }

    void leave(int material, Counters& counters) {
        const std::size_t i = newest(material);
        if (i == kNone) {
            ++counters.unmatched_exits;
            return;
        }
        for (std::size_t k = i + 1; k < size_; ++k) entries_[k - 1] = entries_[k];
        --size_;
    }

    bool contains(int material) const { return newest(material) != kNone; }

 private:
    struct Entry {
        int material = -1, priority = 0;
        bool matched = false;
    };
    static constexpr std::size_t kNone = ~std::size_t(0);

    int best(std::size_t skip, bool with_matched) const {
        int best = -1, best_priority = 0;
        for (std::size_t i = 0; i < size_; ++i) {
            if (i == skip || (entries_[i].matched && !with_matched)) continue;
            if (best < 0 || entries_[i].priority >= best_priority) {
                best = entries_[i].material;
                best_priority = entries_[i].priority;
            }
        }
        return best;
    }

    std::size_t newest(int material) const {
        for (std::size_t i = size_; i-- > 0;)
            if (entries_[i].material == material) return i;
        return kNone;
    }

    std::array<Entry, kCapacity> entries_;
    std::size_t size_ = 0;
};

/// What the boundary of a medium is where a path meets it.
struct InterfaceCrossing {
    bool hidden = false;      ///< lies inside a medium of higher priority: nothing is there to see
    float eta_rel = 1;        ///< index beyond the surface over the index on the path's side
    bool dispersive = false;  ///< eta_rel is that of one lane; others may have another
};

/// `entering`: the path comes from outside the closed shape. `lane` is the path's own; where the
/// indices differ between lanes it decides.
inline InterfaceCrossing cross_interface(const MaterialTable& materials, int material,
                                         bool entering, const InteriorStack& inside, int lane = 0) {
    const auto between = [&](int from, int to) -> InterfaceCrossing {
        const auto eta = [&](int m) { return m < 0 ? 1.0F : materials[m].eta_interior[lane]; };
        const auto dispersive = [&](int m) { return m >= 0 && materials[m].dispersive; };
        return {false, eta(to) / eta(from), dispersive(from) || dispersive(to)};
    };
    const bool matched = materials[material].matched;
    if (entering) {
        const int around = inside.current();
        if (around >= 0 && materials[around].priority > materials[material].priority)
            return {true, 1, false};
        return matched ? InterfaceCrossing{} : between(inside.refracting_without(-1), material);
    }
    if (inside.contains(material) && inside.current() != material) return {true, 1, false};
    return matched ? InterfaceCrossing{} : between(material, inside.refracting_without(material));
}

}  // namespace matiere
