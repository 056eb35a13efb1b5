// Which media a point lies in.
#pragma once

#include "scene/interior.h"

namespace matiere {

class Scene;

/// Follows a ray from `p` out of the scene: a medium that is left without having been entered is
/// one that p lies in. Found from the inside outwards, so stacked in reverse.
InteriorStack media_at(const Scene& scene, Vec3f p);

}  // namespace matiere
