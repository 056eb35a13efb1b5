// What a built scene needs of the path kernels, found by looking at everything in it.
#pragma once

#include "base/features.h"

namespace matiere {

class Scene;
class MaterialTable;

/// Texture coordinates of a mesh are kept where its material reads them.
bool reads_uv(const MaterialTable& materials, int material);

Features scan_features(const Scene& scene);

}  // namespace matiere
