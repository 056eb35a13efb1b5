// The one exception of the core. Thrown while a scene is built, never while it is rendered.
#pragma once

#include <stdexcept>
#include <string>
#include <utility>

namespace matiere {

class SceneError : public std::runtime_error {
 public:
    SceneError(std::string code, const std::string& message, std::string pointer = "")
        : std::runtime_error(message), code_(std::move(code)), pointer_(std::move(pointer)) {}

    const std::string& code() const { return code_; }        ///< stable machine word
    const std::string& pointer() const { return pointer_; }  ///< JSON pointer, may be empty

 private:
    std::string code_;
    std::string pointer_;
};

}  // namespace matiere
