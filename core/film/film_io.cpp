// Byte forms of chunks and films: fixed header, cost, counts, sums, CRC-64 (ECMA-182, reflected).
#include <array>
#include <bit>
#include <cstring>
#include <string>
#include <type_traits>

#include "base/error.h"
#include "film/counter_fields.h"
#include "film/film.h"

namespace matiere {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::uint64_t kChunkMagic = 0x314b4e4843544d89ULL;  // 0x89 "MTCHNK1"
constexpr std::uint64_t kFilmMagic = 0x314d4c4946544d89ULL;   // 0x89 "MTFILM1"
constexpr std::uint32_t kByteVersion = 4;   // 1 has no provenance, 2 no cuts, 3 no layers
constexpr std::uint32_t kLayerVersion = 5;  // 4 with a light layer at the end

using CrcTables = std::array<std::array<std::uint64_t, 256>, 8>;

// Table k: the remainder of a byte that k zero bytes follow, so that eight bytes go at once.
constexpr CrcTables make_crc_tables() {
    CrcTables tables{};
    for (std::uint64_t i = 0; i < 256; ++i) {
        std::uint64_t crc = i;
        for (int bit = 0; bit < 8; ++bit)
            crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xc96c5795d7870f42ULL : 0);
        tables[0][i] = crc;
    }
    for (std::size_t k = 1; k < 8; ++k)
        for (std::size_t i = 0; i < 256; ++i)
            tables[k][i] = (tables[k - 1][i] >> 8) ^ tables[0][tables[k - 1][i] & 0xff];
    return tables;
}

std::uint64_t crc64(std::span<const std::byte> bytes) {
    static constexpr auto kTables = make_crc_tables();
    std::uint64_t crc = ~std::uint64_t(0);
    std::size_t at = 0;
    for (; at + 8 <= bytes.size(); at += 8) {
        std::uint64_t word = 0;
        std::memcpy(&word, bytes.data() + at, sizeof word);
        word ^= crc;
        crc = 0;
        for (std::size_t k = 0; k < 8; ++k) crc ^= kTables[7 - k][(word >> (8 * k)) & 0xff];
    }
    for (; at < bytes.size(); ++at)
        crc = kTables[0][(crc ^ std::uint64_t(bytes[at])) & 0xff] ^ (crc >> 8);
    return ~crc;
}

[[noreturn]] void damaged(const std::string& why) {
    throw SceneError("damaged_film", "the film bytes are damaged: " + why);
}

class Writer {
 public:
    explicit Writer(std::size_t expected) { bytes_.reserve(expected); }

    template <class T>
    void put(const T& value) {
        put_all(std::span<const T>(&value, 1));
    }
    template <class T>
    void put_all(std::span<const T> values) {
        static_assert(std::is_trivially_copyable_v<T>);
        const auto raw = std::as_bytes(values);
        bytes_.insert(bytes_.end(), raw.begin(), raw.end());
    }
    std::vector<std::byte> finish() {
        put(crc64(bytes_));
        return std::move(bytes_);
    }

 private:
    std::vector<std::byte> bytes_;
};

class Reader {
 public:
    Reader(std::span<const std::byte> bytes, std::uint64_t magic) : bytes_(bytes) {
        if (bytes.size() < 3 * sizeof(std::uint64_t)) damaged("they are cut short");
        if (get<std::uint64_t>() != magic) damaged("they do not begin as a film or chunk does");
        version_ = get<std::uint32_t>();
        if (version_ > kLayerVersion)
            throw SceneError("newer_film", "the film was written by a newer matiere (format " +
                                               std::to_string(version_) + ", this one reads " +
                                               std::to_string(kLayerVersion) + ")");
        std::uint64_t stored = 0;
        const std::size_t body = bytes.size() - sizeof stored;
        std::memcpy(&stored, bytes.data() + body, sizeof stored);
        if (stored != crc64(bytes.first(body))) damaged("the checksum does not match");
        bytes_ = bytes.first(body);
    }

    template <class T>
    T get() {
        T value{};
        get_all(std::span<T>(&value, 1));
        return value;
    }
    template <class T>
    void get_all(std::span<T> values) {
        static_assert(std::is_trivially_copyable_v<T>);
        const std::size_t size = values.size_bytes();
        if (bytes_.size() - at_ < size) damaged("they are cut short");
        if (size > 0) std::memcpy(values.data(), bytes_.data() + at_, size);
        at_ += size;
    }
    std::uint32_t version() const { return version_; }
    std::size_t left() const { return bytes_.size() - at_; }
    void end() const {
        if (left() != 0) damaged("there are bytes after the end");
    }

 private:
    std::span<const std::byte> bytes_;
    std::size_t at_ = 0;
    std::uint32_t version_ = 0;
};

void put_head(Writer& out, std::uint64_t magic, const Plan& plan, bool light_layer) {
    out.put(magic);
    out.put(light_layer ? kLayerVersion : kByteVersion);
    const int version = plan.adaptive() ? Plan::kAdaptiveVersion : Plan::kVersion;
    for (const int n : {version, plan.width(), plan.height(), plan.replicates()})
        out.put(std::int32_t(n));
}

Plan get_plan(Reader& in) {
    const auto version = in.get<std::int32_t>();
    if (version != Plan::kVersion && version != Plan::kAdaptiveVersion)
        throw SceneError("other_plan", "the film follows chunk plan version " +
                                           std::to_string(version) + ", this matiere versions " +
                                           std::to_string(Plan::kVersion) + " and " +
                                           std::to_string(Plan::kAdaptiveVersion));
    const auto width = in.get<std::int32_t>();
    const auto height = in.get<std::int32_t>();
    const auto replicates = in.get<std::int32_t>();
    return {width, height, replicates, version == Plan::kAdaptiveVersion};
}

void put_work(Writer& out, const Work& work) {
    out.put(work.cpu_s);
    out.put(work.wall_s);
    for_each_counter(work.counters, [&](std::string_view, std::uint64_t n) { out.put(n); });
    out.put(std::uint64_t(work.counters.rejected.size()));
    for (const auto& row : work.counters.rejected) out.put_all(std::span<const std::uint64_t>(row));
}

Work get_work(Reader& in) {
    Work work;
    work.cpu_s = in.get<double>();
    work.wall_s = in.get<double>();
    for_each_counter(work.counters,
                     [&](std::string_view, std::uint64_t& n) { n = in.get<std::uint64_t>(); });
    const auto rows = in.get<std::uint64_t>();
    if (rows > in.left() / sizeof(work.counters.rejected[0])) damaged("they are cut short");
    work.counters.rejected.resize(rows);
    for (auto& row : work.counters.rejected) in.get_all(std::span<std::uint64_t>(row));
    return work;
}

void put_provenance(Writer& out, const Provenance& provenance) {
    out.put(provenance.found);
    out.put(provenance.kernels);
    out.put(std::uint32_t(provenance.outliers.list().size()));
    for (const Outlier& o : provenance.outliers.list()) {
        out.put(o.seed);
        out.put(o.index);
        out.put(o.replicate);
        out.put(o.x);
        out.put(o.y);
        out.put(o.value);
    }
}

Provenance get_provenance(Reader& in) {
    Provenance provenance;
    if (in.version() < 2) return provenance;
    provenance.found = in.get<Features>();
    provenance.kernels = in.get<std::uint32_t>();
    const auto count = in.get<std::uint32_t>();
    if (count > Outliers::kMost) damaged("they hold too many outliers");
    for (std::uint32_t i = 0; i < count; ++i) {
        Outlier o;
        o.seed = in.get<std::uint64_t>();
        o.index = in.get<std::uint64_t>();
        o.replicate = in.get<std::uint32_t>();
        o.x = in.get<std::int32_t>();
        o.y = in.get<std::int32_t>();
        o.value = in.get<std::array<float, 3>>();
        provenance.outliers.offer(o);
    }
    return provenance;
}

void put_cuts(Writer& out, std::span<const Cuts> all) {
    for (const Cuts& cuts : all)
        for (const CutSums& c : cuts) {
            out.put(c.paths);
            out.put(c.followed);
            out.put(c.light);
            out.put(c.squares);
        }
}

void get_cuts(Reader& in, std::span<Cuts> all) {
    if (in.version() < 3) return;
    for (Cuts& cuts : all)
        for (CutSums& c : cuts) {
            c.paths = in.get<std::uint64_t>();
            c.followed = in.get<std::uint64_t>();
            c.light = in.get<std::array<double, 3>>();
            c.squares = in.get<std::array<double, 3>>();
        }
}

AovSet get_layers(Reader& in) {
    const AovSet layers = in.version() < 4 ? 0 : in.get<AovSet>();
    return AovLayout(layers).set();
}

void put_record(Writer& out, const AdaptiveState::Record& record) {
    out.put(record.floors);
    out.put(std::uint64_t(record.worth.size()));
    out.put_all(std::span<const double>(record.worth));
    out.put_all(std::span<const std::uint64_t>(record.rays));
}

void put_splats(Writer& out, const std::vector<SplatSums>& splats, std::uint64_t paths) {
    out.put(paths);
    for (const SplatSums& s : splats) {
        out.put(std::uint64_t(s.pixels().size()));
        out.put_all(std::span<const std::uint32_t>(s.pixels()));
        out.put_all(std::span<const SplatSums::Value>(s.sums()));
    }
}

void get_splats(Reader& in, SplatSums& splats, std::uint32_t pixels) {
    const auto size = in.get<std::uint64_t>();
    if (size > in.left() / (sizeof(std::uint32_t) + sizeof(SplatSums::Value)))
        damaged("they are cut short");
    std::vector<std::uint32_t> at(size);
    std::vector<SplatSums::Value> values(size);
    in.get_all(std::span<std::uint32_t>(at));
    in.get_all(std::span<SplatSums::Value>(values));
    for (std::size_t i = 0; i < size; ++i) {
        if (at[i] >= pixels) damaged("a splat lies outside the film");
        splats.add(at[i], values[i]);
    }
    if (splats.pixels().size() != size) damaged("a pixel has two splats");
}

AdaptiveState::Record get_record(Reader& in, const Plan& plan) {
    AdaptiveState::Record record;
    in.get_all(std::span<double>(record.floors));
    const auto size = in.get<std::uint64_t>();
    if (size > in.left() / sizeof(double)) damaged("they are cut short");
    record.worth.resize(size);
    in.get_all(std::span<double>(record.worth));
    record.rays.resize(std::size_t(plan.strips()));
    in.get_all(std::span<std::uint64_t>(record.rays));
    return record;
}

}  // namespace

std::vector<std::byte> ChunkFilm::to_bytes() const {
    Writer out(sums_.size() * sizeof(double) + counts_.size() * sizeof(std::uint32_t) + 4096);
    put_head(out, kChunkMagic, plan_, has_splats());
    out.put(chunk_.index);
    put_work(out, work_);
    put_provenance(out, provenance_);
    put_cuts(out, {&cuts_, 1});
    out.put(layout_.set());
    out.put_all(counts());
    out.put_all(sums());
    out.put_all(aovs());
    if (has_splats()) put_splats(out, splats_, light_paths_);
    return out.finish();
}

ChunkFilm ChunkFilm::from_bytes(std::span<const std::byte> bytes) {
    Reader in(bytes, kChunkMagic);
    const Plan plan = get_plan(in);
    const auto index = in.get<std::uint32_t>();
    Work work = get_work(in);
    Provenance provenance = get_provenance(in);
    Cuts cuts{};
    get_cuts(in, {&cuts, 1});
    ChunkFilm part(plan, index, get_layers(in));
    part.work_ = std::move(work);
    part.provenance_ = std::move(provenance);
    part.cuts_ = cuts;
    in.get_all(std::span<std::uint32_t>(part.counts_));
    in.get_all(std::span<double>(part.sums_));
    in.get_all(std::span<double>(part.aovs_));
    if (in.version() >= kLayerVersion) {
        part.begin_splats(in.get<std::uint64_t>());
        const auto pixels = std::uint32_t(plan.width()) * std::uint32_t(plan.height());
        for (SplatSums& splats : part.splats_) get_splats(in, splats, pixels);
    }
    in.end();
    const std::uint64_t expected = (part.chunk_.s1 - part.chunk_.s0) / std::uint64_t(plan.halves());
    for (const auto n : part.counts_)
        if (n != expected) damaged("a sample count is not that of the chunk");
    return part;
}

std::vector<std::byte> Film::to_bytes() const {
    Writer out(sums_.size() * sizeof(double) + counts_.size() * sizeof(std::uint32_t) + 4096);
    put_head(out, kFilmMagic, plan_, has_light_layer());
    out.put(std::uint32_t(merged_));
    put_work(out, work_);
    put_provenance(out, provenance_);
    put_cuts(out, cuts_);
    out.put(layout_.set());
    out.put_all(counts());
    out.put_all(std::span<const double>(sums_));
    out.put_all(first_counts());
    out.put_all(std::span<const double>(aovs_));
    if (has_light_layer()) {
        out.put(light_paths_);
        out.put_all(std::span<const double>(light_sums_));
    }
    if (adaptive_) put_record(out, adaptive_->record());
    return out.finish();
}

Film Film::from_bytes(std::span<const std::byte> bytes) {
    Reader in(bytes, kFilmMagic);
    const Plan plan = get_plan(in);
    const auto merged = in.get<std::uint32_t>();
    Work work = get_work(in);
    Provenance provenance = get_provenance(in);
    std::vector<Cuts> cuts(std::size_t(plan.strips()));
    get_cuts(in, cuts);
    const std::size_t pixels = std::size_t(plan.width()) * std::size_t(plan.height());
    const AovSet layers = get_layers(in);
    const bool lit = in.version() >= kLayerVersion;
    const std::size_t size =
        pixels * bytes_per_pixel(plan.replicates(), plan.adaptive(), layers, lit) +
        (lit ? sizeof(light_paths_) : 0);
    if (plan.adaptive() ? in.left() < size : in.left() != size) damaged("their length is wrong");
    Film film(plan);
    film.merged_ = merged != 0;
    film.work_ = std::move(work);
    film.provenance_ = std::move(provenance);
    film.cuts_ = std::move(cuts);
    in.get_all(std::span<std::uint32_t>(film.counts_));
    in.get_all(std::span<double>(film.sums_));
    in.get_all(std::span<std::uint32_t>(film.first_counts_));
    film.set_layers(layers);
    in.get_all(std::span<double>(film.aovs_));
    if (lit) {
        film.light_paths_ = in.get<decltype(film.light_paths_)>();
        const int planes = light_planes(plan.replicates(), plan.halves(), layers);
        film.light_sums_.resize(pixels * std::size_t(planes) * kSplatChannels);
        in.get_all(std::span<double>(film.light_sums_));
    }
    film.check_counts();
    if (film.merged_)
        film.adaptive_.reset();
    else if (plan.adaptive())
        film.restore(get_record(in, plan));
    in.end();
    return film;
}

void Film::check_counts() const {
    for (int strip = 0; strip < plan_.strips(); ++strip) {
        const Chunk c = plan_.chunk(std::uint32_t(strip));
        const std::uint64_t spp = strip_spp(strip);
        if (!merged_ && plan_.round_up(spp) != spp) damaged("a sample count is not on the plan");
        for (int y = c.y0; y < c.y1; ++y)
            for (int x = c.x0; x < c.x1; ++x) {
                const std::size_t pixel = std::size_t(y) * std::size_t(width()) + std::size_t(x);
                if (std::uint64_t(plan_.halves()) * count(pixel, c.r0) != spp)
                    damaged("the sample counts of a tile differ");
            }
    }
}

void Film::restore(AdaptiveState::Record record) {
    std::vector<std::uint64_t> ranges;
    for (int strip = 0; strip < plan_.strips(); ++strip)
        ranges.push_back(plan_.ranges(strip_spp(strip)));
    if (!adaptive_->restore(*this, ranges, std::move(record)))
        damaged("their sample counts are not those that they decide");
}

}  // namespace matiere
