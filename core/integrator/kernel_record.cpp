#include "base/parallel.h"
#include "integrator/path_record.h"
#include "integrator/walk.h"

namespace matiere {

PathRecord record_path(const Scene& scene, const PathSettings& settings, const SampleId& id) {
    const FlushDenormals float_mode;  // as in render threads
    PathRecord record;
    Counters counters;
    record.result = trace_path<kEveryFeature | kRecords>(scene, settings, id, counters, &record);
    return record;
}

}  // namespace matiere
