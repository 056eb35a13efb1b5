// How many rays a second Embree alone traces in a box of 36 triangles: the bound of every path
// tracer that stands on it. Rays start anywhere and go anywhere, as they do after the first hit.
//
//     g++ -O3 -march=native -o /tmp/traversal tests/bench/traversal.cpp -lembree3 -pthread
//     /tmp/traversal
//
// With Embree 4 (Debian 13) only the single rays are the same: its contexts are called otherwise.
#include <embree3/rtcore.h>
#include <pmmintrin.h>
#include <xmmintrin.h>

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <thread>
#include <vector>

namespace {

constexpr int kRays = 1 << 16, kRounds = 40;
constexpr float kFar = std::numeric_limits<float>::infinity();
using Vec = std::array<float, 3>;

struct Mesh {
    std::vector<float> positions;
    std::vector<unsigned> triangles;

    void box(Vec low, Vec size) {
        for (int axis = 0; axis < 3; ++axis)
            for (const float side : {0.0F, 1.0F}) {
                const auto first = unsigned(positions.size() / 3);
                for (const auto& [u, v] :
                     {std::pair(0.0F, 0.0F), {1.0F, 0.0F}, {1.0F, 1.0F}, {0.0F, 1.0F}}) {
                    Vec p = low;
                    p[axis] += side * size[axis];
                    p[(axis + 1) % 3] += u * size[(axis + 1) % 3];
                    p[(axis + 2) % 3] += v * size[(axis + 2) % 3];
                    positions.insert(positions.end(), p.begin(), p.end());
                }
                for (const unsigned corner : {0U, 1U, 2U, 0U, 2U, 3U})
                    triangles.push_back(first + corner);
            }
    }
};

template <class T>
void put(RTCGeometry geometry, RTCBufferType type, RTCFormat format, const std::vector<T>& values) {
    auto* to = static_cast<T*>(
        rtcSetNewGeometryBuffer(geometry, type, 0, format, 3 * sizeof(T), values.size() / 3));
    std::copy(values.begin(), values.end(), to);
}

std::vector<RTCRay> random_rays() {
    std::vector<RTCRay> rays(kRays);
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    std::uniform_real_distribution<float> inside(-0.99F, 0.99F);
    for (RTCRay& ray : rays) {
        const float x = normal(random), y = normal(random), z = normal(random);
        const float scale = 1 / std::sqrt(x * x + y * y + z * z);
        ray = {inside(random),
               inside(random),
               inside(random),
               1e-4F,
               x * scale,
               y * scale,
               z * scale,
               0,
               kFar,
               ~0U,
               0,
               0};
    }
    return rays;
}

struct One {
    static constexpr int kWidth = 1;
    static void trace(RTCScene scene, RTCIntersectContext& context, const RTCRay* rays,
                      bool shadow) {
        RTCRayHit query{rays[0], {}};
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        query.ray.tfar = shadow ? 1 : kFar;
        if (shadow)
            rtcOccluded1(scene, &context, &query.ray);
        else
            rtcIntersect1(scene, &context, &query);
    }
};

struct Sixteen {
    static constexpr int kWidth = 16;
    static void trace(RTCScene scene, RTCIntersectContext& context, const RTCRay* rays,
                      bool shadow) {
        alignas(64) std::array<int, kWidth> valid;
        RTCRayHit16 query;
        for (int i = 0; i < kWidth; ++i) {
            valid[i] = -1;
            RTCRay16& to = query.ray;
            to.org_x[i] = rays[i].org_x, to.org_y[i] = rays[i].org_y, to.org_z[i] = rays[i].org_z;
            to.dir_x[i] = rays[i].dir_x, to.dir_y[i] = rays[i].dir_y, to.dir_z[i] = rays[i].dir_z;
            to.tnear[i] = rays[i].tnear, to.tfar[i] = shadow ? 1 : kFar;
            to.time[i] = 0, to.mask[i] = ~0U, to.flags[i] = 0;
            query.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        }
        if (shadow)
            rtcOccluded16(valid.data(), scene, &context, &query.ray);
        else
            rtcIntersect16(valid.data(), scene, &context, &query);
    }
};

template <class Packet>
void measure(RTCScene scene, const std::vector<RTCRay>& rays, bool shadow) {
    const auto work = [&] {
        _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
        _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        for (int round = 0; round < kRounds; ++round)
            for (int i = 0; i < kRays; i += Packet::kWidth)
                Packet::trace(scene, context, &rays[i], shadow);
    };
    const auto begin = std::chrono::steady_clock::now();
    std::thread one(work), two(work);
    one.join();
    two.join();
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - begin;
    std::printf("%s rays, %d at once: %.1f Mrays/s on 2 threads\n",
                shadow ? "shadow" : "closest-hit", Packet::kWidth,
                2e-6 * kRounds * kRays / seconds.count());
}

}  // namespace

int main() {
    Mesh mesh;
    mesh.box({-1, -1, -1}, {2, 2, 2});
    mesh.box({-0.6F, -1, -0.6F}, {0.5F, 1.2F, 0.5F});
    mesh.box({0.1F, -1, 0.1F}, {0.5F, 0.6F, 0.5F});
    RTCDevice device = rtcNewDevice("threads=1");
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    put(geometry, RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, mesh.positions);
    put(geometry, RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, mesh.triangles);
    rtcCommitGeometry(geometry);
    RTCScene scene = rtcNewScene(device);
    rtcAttachGeometry(scene, geometry);
    rtcCommitScene(scene);
    const auto rays = random_rays();
    for (const bool shadow : {false, true}) {
        measure<One>(scene, rays, shadow);
        measure<Sixteen>(scene, rays, shadow);
    }
}
