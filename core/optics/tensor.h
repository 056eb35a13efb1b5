// Arrays that a measured material is made of, as its file holds them.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

namespace matiere {

struct Tensor {
    std::vector<std::size_t> shape;
    std::vector<float> values;  ///< row-major

    bool has_shape(const std::vector<std::size_t>& wanted) const {
        std::size_t n = 1;
        for (const std::size_t s : wanted) n *= s;
        return shape == wanted && values.size() == n;
    }
};

using TensorSet = std::map<std::string, Tensor>;

}  // namespace matiere
