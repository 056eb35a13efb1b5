#include "accel/embree_device.h"

#include "accel/embree_api.h"
#include "base/error.h"

namespace matiere {

const char* embree_isa() { return "avx2"; }

EmbreeDevice::EmbreeDevice(int threads) {
    std::string config = "isa=" + std::string(embree_isa()) + ",set_affinity=0,start_threads=0";
    if (threads > 0) config += ",threads=" + std::to_string(threads);
    RTCDevice device = rtcNewDevice(config.c_str());
    if (device == nullptr)
        throw SceneError("embree_device", "Embree could not create a device with '" + config + "'");
    handle_ = std::shared_ptr<void>(device, [](void* d) { rtcReleaseDevice(RTCDevice(d)); });
}

void EmbreeDevice::check(const char* what) const {
    const RTCError code = rtcGetDeviceError(RTCDevice(handle_.get()));
    if (code == RTC_ERROR_NONE) return;
    if (code == RTC_ERROR_CANCELLED) throw SceneError("cancelled", "scene build was cancelled");
    if (code == RTC_ERROR_OUT_OF_MEMORY)
        throw SceneError("out_of_memory", std::string("Embree ran out of memory in ") + what);
    throw SceneError("embree", std::string("Embree failed in ") + what + ", error code " +
                                   std::to_string(int(code)));
}

std::string embree_version() { return RTC_VERSION_STRING; }

}  // namespace matiere
