// The Embree device, and the only place that knows which Embree (3.13 or 4.x) is underneath.
#pragma once

#include <memory>
#include <string>

namespace matiere {

/// A device with its own thread count for builds. The ISA is pinned, so that one binary gives the
/// same hits on every machine that can run it.
class EmbreeDevice {
 public:
    explicit EmbreeDevice(int threads);
    void* handle() const { return handle_.get(); }
    /// Throws SceneError if Embree has reported an error since the last call.
    void check(const char* what) const;

 private:
    std::shared_ptr<void> handle_;
};

std::string embree_version();
/// The instruction set every device is pinned to.
const char* embree_isa();

}  // namespace matiere
