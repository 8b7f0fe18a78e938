// Reads one cage from standard input (see make_subdivision.py), refines it uniformly with OpenSubdiv and
// prints limit positions, limit normals and face-varying limit values as JSON.
// c++ -std=c++14 opensubdiv_limit.cpp -losdCPU   (Debian: libosd-dev 3.5.0)

#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <opensubdiv/far/primvarRefiner.h>
#include <opensubdiv/far/topologyDescriptor.h>
#include <string>
#include <vector>

using namespace OpenSubdiv;

template <int N> struct Value {
    float x[N];
    void Clear(void * = nullptr) { for (float &c : x) c = 0; }
    void AddWithWeight(Value const &v, float w) { for (int i = 0; i < N; ++i) x[i] += w * v.x[i]; }
};
using P = Value<3>;
using UV = Value<2>;

template <class T> std::vector<T> list() {
    int n = 0;
    std::cin >> n;
    std::vector<T> values(n);
    for (T &value : values) std::cin >> value;
    return values;
}

template <int N> std::vector<Value<N>> vectors() {
    std::vector<float> flat = list<float>();
    std::vector<Value<N>> values(flat.size() / N);
    for (size_t i = 0; i < flat.size(); ++i) values[i / N].x[i % N] = flat[i];
    return values;
}

template <int N> void print(char const *name, std::vector<Value<N>> const &values) {
    std::printf(",\n\"%s\": [", name);
    for (size_t i = 0; i < values.size(); ++i) {
        for (int k = 0; k < N; ++k) std::printf("%s%.7g", k ? "," : i ? ",[" : "[", values[i].x[k] + 0.0f);
        std::printf("]");
    }
    std::printf("]");
}

// Only vertices with one sector of surface around them have one normal; others print as zero.
// So do irregular boundary vertices of more faces than a regular one: OpenSubdiv's tangents there are those of other
// subdivision rules.
bool has_one_normal(Far::TopologyLevel const &level, int v, bool loop) {
    auto rule = level.GetVertexRule(v);
    if (rule == Sdc::Crease::RULE_SMOOTH || rule == Sdc::Crease::RULE_DART) return level.GetVertexEdges(v).size() > 2;
    if (rule == Sdc::Crease::RULE_CREASE) {
        return level.IsVertexBoundary(v) && level.GetVertexFaces(v).size() <= (loop ? 3 : 2);
    }
    return level.GetVertexFaces(v).size() == 1;
}

P normal(P const &a, P const &b) {
    P n = {{a.x[1] * b.x[2] - a.x[2] * b.x[1], a.x[2] * b.x[0] - a.x[0] * b.x[2], a.x[0] * b.x[1] - a.x[1] * b.x[0]}};
    float length = std::sqrt(n.x[0] * n.x[0] + n.x[1] * n.x[1] + n.x[2] * n.x[2]);
    for (float &c : n.x) c /= length;
    return n;
}

int main() {
    std::string scheme;
    int boundary, fvar_linear, smooth_triangles, depth;
    std::cin >> scheme >> boundary >> fvar_linear >> smooth_triangles >> depth;
    std::vector<P> points = vectors<3>();
    std::vector<int> counts = list<int>(), indices = list<int>(), crease_pairs = list<int>();
    std::vector<float> crease_weights = list<float>();
    std::vector<int> corners = list<int>();
    std::vector<float> corner_weights = list<float>();
    std::vector<int> holes = list<int>();
    std::vector<UV> uvs = vectors<2>();
    std::vector<int> uv_indices = list<int>();

    Far::TopologyDescriptor d;
    d.numVertices = int(points.size());
    d.numFaces = int(counts.size());
    d.numVertsPerFace = counts.data();
    d.vertIndicesPerFace = indices.data();
    d.numCreases = int(crease_weights.size());
    d.creaseVertexIndexPairs = crease_pairs.data();
    d.creaseWeights = crease_weights.data();
    d.numCorners = int(corners.size());
    d.cornerVertexIndices = corners.data();
    d.cornerWeights = corner_weights.data();
    d.numHoles = int(holes.size());
    d.holeIndices = holes.data();
    Far::TopologyDescriptor::FVarChannel channel;
    channel.numValues = int(uvs.size());
    channel.valueIndices = uv_indices.data();
    d.numFVarChannels = uvs.empty() ? 0 : 1;
    d.fvarChannels = &channel;

    Sdc::Options options;
    options.SetVtxBoundaryInterpolation(Sdc::Options::VtxBoundaryInterpolation(boundary));
    options.SetFVarLinearInterpolation(Sdc::Options::FVarLinearInterpolation(fvar_linear));
    options.SetTriangleSubdivision(Sdc::Options::TriangleSubdivision(smooth_triangles));
    Sdc::SchemeType type = scheme == "loop" ? Sdc::SCHEME_LOOP : scheme == "bilinear" ? Sdc::SCHEME_BILINEAR : Sdc::SCHEME_CATMARK;
    using Factory = Far::TopologyRefinerFactory<Far::TopologyDescriptor>;
    std::unique_ptr<Far::TopologyRefiner> refiner(Factory::Create(d, Factory::Options(type, options)));
    if (!refiner) return 1;
    Far::TopologyRefiner::UniformOptions uniform(depth);
    uniform.fullTopologyInLastLevel = true;
    refiner->RefineUniform(uniform);

    Far::PrimvarRefiner primvars(*refiner);
    for (int l = 1; l <= depth; ++l) {
        std::vector<P> next(refiner->GetLevel(l).GetNumVertices());
        primvars.Interpolate(l, points, next);
        points = next;
        if (!uvs.empty()) {
            std::vector<UV> next_uvs(refiner->GetLevel(l).GetNumFVarValues());
            primvars.InterpolateFaceVarying(l, uvs, next_uvs);
            uvs = next_uvs;
        }
    }
    std::vector<P> limit(points.size()), t1(points.size()), t2(points.size()), normals(points.size());
    primvars.Limit(points, limit, t1, t2);
    Far::TopologyLevel const &last = refiner->GetLevel(depth);
    for (size_t v = 0; v < points.size(); ++v) {
        normals[v].Clear();
        if (has_one_normal(last, int(v), type == Sdc::SCHEME_LOOP)) normals[v] = normal(t1[v], t2[v]);
    }
    std::printf("\"faces\": [");
    for (int f = 0; f < last.GetNumFaces(); ++f) {
        auto vertices = last.GetFaceVertices(f);
        for (int i = 0; i < vertices.size(); ++i) std::printf("%s%d", f || i ? "," : "", vertices[i]);
    }
    std::printf("],\n\"holes\": [");
    bool first = true;
    for (int f = 0; f < last.GetNumFaces(); ++f) {
        if (last.IsFaceHole(f)) std::printf("%s%d", first ? "" : ",", f), first = false;
    }
    std::printf("]");
    print("limit", limit);
    print("normals", normals);
    if (!uvs.empty()) {
        std::vector<UV> limit_uvs(uvs.size());
        primvars.LimitFaceVarying(uvs, limit_uvs);
        print("uv", limit_uvs);
        std::printf(",\n\"uvFaces\": [");
        for (int f = 0; f < last.GetNumFaces(); ++f) {
            auto values = last.GetFaceFVarValues(f);
            for (int i = 0; i < values.size(); ++i) std::printf("%s%d", f || i ? "," : "", values[i]);
        }
        std::printf("]");
    }
    std::printf("\n");
}
