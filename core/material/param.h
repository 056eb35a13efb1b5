// Parameter tables: what a model can be told, as data. The JSON schema, the validation, the docs
// rows and the binding of textures are all made from these tables.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <string_view>

#include "base/spectrum.h"
#include "material/nested.h"
#include "optics/tensor.h"

namespace matiere {

inline constexpr double kUnlimited = std::numeric_limits<double>::infinity();

enum class ParamKind : std::uint8_t {
    kScalar,
    kColor,
    kBool,
    kEnum,
    kMetal,
    kMaterial,
    kFile,
    kList
};

/// The type-erased part of one row.
struct ParamInfo {
    std::string_view name;
    ParamKind kind{};
    double min = 0.0;
    double max = kUnlimited;
    bool min_exclusive = false;
    bool has_default = false;
    bool required = false;       ///< must be given (a rule may ask for one of several instead)
    bool constant_only = false;  ///< shapes a table, so it takes no texture
    double default_value = 0.0;  ///< colours repeat it; enums: index of the choice
    std::string_view unit;
    std::string_view doc;
    std::string_view reason;  ///< why the lower bound is where it is
    std::span<const std::string_view> choices;
};

/// A parameter's value, whether the scene gave it, and whether a texture fills it at each hit.
template <class T>
struct Value {
    T v{};
    bool given = false;
    bool textured = false;
};

/// One row of the table of a parameter struct P: its facts and the member it fills.
template <class P, class R>
struct Param {
    ParamInfo info;
    Value<R> P::* scalar = nullptr;
    Value<Spectrum<R>> P::* color = nullptr;
    Value<int> P::* choice = nullptr;  ///< enums and bools
    Value<Nested<R>> P::* nested = nullptr;
    Value<const TensorSet*> P::* data = nullptr;  ///< what a file holds

    constexpr Param range(double min, double max) const {
        Param p = *this;
        p.info.min = min;
        p.info.max = max;
        return p;
    }
    constexpr Param above(double min, double max) const {
        Param p = range(min, max);
        p.info.min_exclusive = true;
        return p;
    }
    constexpr Param initially(double value) const {
        Param p = *this;
        p.info.has_default = true;
        p.info.default_value = value;
        return p;
    }
    constexpr Param unit(std::string_view text) const {
        Param p = *this;
        p.info.unit = text;
        return p;
    }
    constexpr Param because(std::string_view text) const {
        Param p = *this;
        p.info.reason = text;
        return p;
    }
    constexpr Param constant_only() const {
        Param p = *this;
        p.info.constant_only = true;
        return p;
    }
    constexpr Param required() const {
        Param p = *this;
        p.info.required = true;
        return p;
    }
};

template <class P, class R>
constexpr Param<P, R> scalar(std::string_view name, Value<R> P::* member, std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kScalar;
    p.info.doc = doc;
    p.scalar = member;
    return p;
}

template <class P, class R>
constexpr Param<P, R> color(std::string_view name, Value<Spectrum<R>> P::* member,
                            std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kColor;
    p.info.doc = doc;
    p.color = member;
    return p;
}

template <class P, class R>
constexpr Param<P, R> choice(std::string_view name, Value<int> P::* member,
                             std::span<const std::string_view> choices, std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kEnum;
    p.info.doc = doc;
    p.info.choices = choices;
    p.info.constant_only = true;
    p.choice = member;
    return p;
}

/// Another material, given as an object with its own type and parameters.
template <class P, class R>
constexpr Param<P, R> material(std::string_view name, Value<Nested<R>> P::* member,
                               std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kMaterial;
    p.info.doc = doc;
    p.info.constant_only = true;
    p.nested = member;
    return p;
}

/// A file of measured reflection, read before the core sees the material.
template <class P, class R>
constexpr Param<P, R> measured_file(std::string_view name, Value<const TensorSet*> P::* member,
                                    std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kFile;
    p.info.doc = doc;
    p.info.constant_only = true;
    p.data = member;
    return p;
}

template <class P, class R>
constexpr Param<P, R> flag(std::string_view name, Value<int> P::* member, std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kBool;
    p.info.doc = doc;
    p.info.constant_only = true;
    p.choice = member;
    return p;
}

/// A list of objects with parameters of their own; the member holds how many are given. `range` and
/// `initially` are of their number. The parameters of object k are rows of the same table, with the
/// names "list/k/name", which is where errors point.
template <class P, class R>
constexpr Param<P, R> list(std::string_view name, Value<int> P::* member, std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kList;
    p.info.doc = doc;
    p.info.constant_only = true;
    p.choice = member;
    return p;
}

/// A metal's name: resolved to `eta` and `k` before the core sees the material.
template <class P, class R>
constexpr Param<P, R> metal(std::string_view name, std::string_view doc) {
    Param<P, R> p;
    p.info.name = name;
    p.info.kind = ParamKind::kMetal;
    p.info.doc = doc;
    p.info.constant_only = true;
    return p;
}

/// The rows (or rules) of a, then those of b.
template <class T, std::size_t A, std::size_t B>
constexpr std::array<T, A + B> join(const std::array<T, A>& a, const std::array<T, B>& b) {
    std::array<T, A + B> all{};
    for (std::size_t i = 0; i < A; ++i) all[i] = a[i];
    for (std::size_t i = 0; i < B; ++i) all[A + i] = b[i];
    return all;
}

/// What a model's own check found wrong; an empty message means nothing.
struct ParamError {
    std::string_view param;
    std::string_view message;
};

/// What parameters may be given together.
enum class RuleKind : std::uint8_t {
    kExclusive,  ///< at most one of the names
    kOneOf,      ///< at least one of the names
    kTogether,   ///< all of the names or none
    kRequires,   ///< the first name only with the second
};

struct Rule {
    RuleKind kind{};
    std::array<std::string_view, 4> names{};  ///< unused entries are empty

    constexpr std::size_t size() const {
        std::size_t n = 0;
        while (n < names.size() && !names[n].empty()) ++n;
        return n;
    }
};

constexpr Rule exclusive(std::string_view a, std::string_view b, std::string_view c = {},
                         std::string_view d = {}) {
    return {RuleKind::kExclusive, {a, b, c, d}};
}
constexpr Rule one_of(std::string_view a, std::string_view b, std::string_view c = {}) {
    return {RuleKind::kOneOf, {a, b, c}};
}
constexpr Rule together(std::string_view a, std::string_view b) {
    return {RuleKind::kTogether, {a, b}};
}
constexpr Rule requires_param(std::string_view a, std::string_view b) {
    return {RuleKind::kRequires, {a, b}};
}

}  // namespace matiere
