// What a render counted instead of hiding, as rows for the report.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "base/guard.h"

namespace matiere {

struct RejectionRow {
    int material = -1;  ///< index in the material table; -1 = none (background or a whole path)
    std::string_view cause;
    std::uint64_t count = 0;
};

/// The non-zero entries of the rejection table.
inline std::vector<RejectionRow> rejection_rows(const Counters& counters) {
    std::vector<RejectionRow> rows;
    for (std::size_t m = 0; m < counters.rejected.size(); ++m)
        for (std::size_t c = 0; c < kRejectNames.size(); ++c)
            if (const auto n = counters.rejected[m][c]; n > 0)
                rows.push_back({int(m) - 1, kRejectNames[c], n});
    return rows;
}

}  // namespace matiere
