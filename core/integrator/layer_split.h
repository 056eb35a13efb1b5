// What a path from the camera leaves to the light layer (scene/light_layer.h).
#pragma once

#include "material/bsdf.h"
#include "scene/light_layer.h"

namespace matiere {

struct LayerSplit {
    const LightLayer* layer = nullptr;  ///< null: nothing

    /// Takes note of event `depth` (from 0) of the path.
    void scatter(int material, std::uint8_t lobe, int depth) {
        if (layer == nullptr) return;
        last_sharp_ = (lobe & kSpecular) != 0 || layer->sharp(material);
        if (depth == 0) wide_ = !last_sharp_;
    }
    /// Whether a light that the path has met after its last event is the layer's.
    bool owns(int light) const { return wide_ && last_sharp_ && layer->owns(light); }
    /// The same for a light seen from a surface by what is no delta there.
    bool owns_from(int material, int light) const {
        return wide_ && layer->sharp(material) && layer->owns(light);
    }
    /// Whether the layer finds what its lights send by way of mirrors to the next surface: of a
    /// path whose first event is wide, or may be.
    bool begins_wide(int depth) const { return layer != nullptr && (wide_ || depth == 0); }

 private:
    bool wide_ = false, last_sharp_ = false;
};

/// Of a kernel that knows of no such layer.
struct NoLayer {};

}  // namespace matiere
