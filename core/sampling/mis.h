// Multiple importance sampling weights (Veach & Guibas 1995).
#pragma once

namespace matiere {

/// Power heuristic with exponent 2 for one sample from each of two techniques. Written with the
/// ratio of the densities so that neither square can overflow or vanish.
inline float power_heuristic(float pdf_this, float pdf_other) {
    if (!(pdf_this > 0)) return 0;
    const float ratio = pdf_other / pdf_this;
    return 1 / (1 + ratio * ratio);
}

}  // namespace matiere
