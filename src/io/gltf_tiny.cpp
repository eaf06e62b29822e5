/* The far side of gltf.c: tinygltf behind a table of C functions (gltf_shim.h).
 *
 * tinygltf makes the JSON; the bytes that it describes never pass through it, as it would hold them
 * twice. It takes the length of a buffer from the bytes it holds, so the buffer is added to its text
 * here. */
#include "io/gltf_shim.h"

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <tiny_gltf.h>

namespace
{

using tinygltf::Value;

#define VISIBILITY "KHR_node_visibility"
#define POINTER "KHR_animation_pointer"
constexpr int NO_NODE = -1;

/* Names come from files; JSON is UTF-8. What is not plain text becomes an underscore. */
std::string plain(const char *text)
{
    std::string out(text);

    for (char &c : out)
        if (c < 32 || c > 126)
            c = '_';
    return out;
}

Value::Object object_of(const char *const *pairs)
{
    Value::Object object;

    for (; pairs && pairs[0]; pairs += 2)
        object[pairs[0]] = Value(plain(pairs[1]));
    return object;
}

size_t component_bytes(int component)
{
    return component == SPIN_GLTF_F32 ? 4 : component == SPIN_GLTF_U16 ? 2 : 1;
}

int type_of(int n_components)
{
    static const int types[] = {TINYGLTF_TYPE_SCALAR, TINYGLTF_TYPE_VEC2, TINYGLTF_TYPE_VEC3,
                                TINYGLTF_TYPE_VEC4};

    return types[n_components - 1];
}

/* An accessor with a buffer view of its own; its index. */
int add_accessor(tinygltf::Model &model, const spin_gltf_attribute &a, uint64_t n, uint64_t offset,
                 int target)
{
    tinygltf::BufferView view;
    tinygltf::Accessor accessor;

    view.buffer = 0;
    view.byteOffset = offset;
    view.byteLength = n * static_cast<size_t>(a.n_components) * component_bytes(a.component);
    view.target = target;
    model.bufferViews.push_back(view);
    accessor.bufferView = static_cast<int>(model.bufferViews.size()) - 1;
    accessor.componentType = a.component;
    accessor.normalized = a.normalised;
    accessor.count = n;
    accessor.type = type_of(a.n_components);
    model.accessors.push_back(accessor);
    return static_cast<int>(model.accessors.size()) - 1;
}

/* Accessors by where their bytes lie. */
using Known = std::map<uint64_t, int>;

int add_mesh(tinygltf::Model &model, const spin_gltf_clip &clip, const spin_gltf_frame &frame,
             Known &known)
{
    tinygltf::Primitive primitive;
    tinygltf::Mesh mesh;
    uint64_t offset = frame.offset;

    primitive.mode = TINYGLTF_MODE_POINTS;
    primitive.extensions[clip.extension] = Value(object_of(clip.extension_values));
    for (int i = 0; i < clip.n_attributes; i++) {
        const spin_gltf_attribute &a = clip.attribute[i];

        if (frame.elsewhere[i]) {
            primitive.attributes[a.name] = known.at(frame.elsewhere[i] - 1);
            continue;
        }
        int index = add_accessor(model, a, frame.n, offset, TINYGLTF_TARGET_ARRAY_BUFFER);

        if (i == 0) {
            model.accessors.back().minValues.assign(frame.low, frame.low + 3);
            model.accessors.back().maxValues.assign(frame.high, frame.high + 3);
        }
        primitive.attributes[a.name] = index;
        known[offset] = index;
        offset += model.bufferViews.back().byteLength;
    }
    mesh.primitives.push_back(primitive);
    model.meshes.push_back(mesh);
    return static_cast<int>(model.meshes.size()) - 1;
}

void add_nodes(tinygltf::Model &model, const spin_gltf_clip &clip)
{
    tinygltf::Scene scene;
    Known known;

    for (int f = 0; f < clip.n_frames; f++) {
        const spin_gltf_frame &frame = clip.frame[f];
        tinygltf::Node node;
        Value::Object extras;

        node.name = "frame_" + std::to_string(frame.number);
        extras["frame"] = Value(frame.number);
        extras["time"] = Value(frame.time);
        node.extras = Value(extras);
        if (frame.n > 0)
            node.mesh = add_mesh(model, clip, frame, known);
        /* Who plays nothing shows the first. */
        if (clip.animated && clip.visibility)
            node.extensions[VISIBILITY] = Value(Value::Object{{"visible", Value(f == 0)}});
        else if (clip.animated)
            node.scale.assign(3, f == 0 ? 1.0 : 0.0);
        model.nodes.push_back(node);
        scene.nodes.push_back(f);
    }
    if (clip.still && clip.still->n > 0) {
        tinygltf::Node node;

        node.name = "still";
        node.mesh = add_mesh(model, clip, *clip.still, known);
        model.nodes.push_back(node);
        scene.nodes.insert(scene.nodes.begin(), clip.n_frames);
    }
    model.scenes.push_back(scene);
    model.defaultScene = 0;
}

/* Frame f's scale or visibility at the keys. */
int add_output(tinygltf::Model &model, const spin_gltf_clip &clip, uint64_t n_keys,
               uint64_t &offset)
{
    static const spin_gltf_attribute scale = {"scale", 3, SPIN_GLTF_F32, false};
    static const spin_gltf_attribute visible = {"visible", 1, SPIN_GLTF_U8, false};
    int index = add_accessor(model, clip.visibility ? visible : scale, n_keys, offset, 0);

    offset += clip.visibility ? (n_keys + 3) / 4 * 4 : 12 * n_keys;
    return index;
}

void aim(tinygltf::AnimationChannel &channel, const spin_gltf_clip &clip, int f)
{
    std::string pointer = "/nodes/" + std::to_string(f) + "/extensions/" VISIBILITY "/visible";

    channel.target_node = f;
    channel.target_path = "scale";
    if (!clip.visibility)
        return;
    channel.target_node = NO_NODE;
    channel.target_path = "pointer";
    channel.target_extensions[POINTER] = Value(Value::Object{{"pointer", Value(pointer)}});
}

void add_animation(tinygltf::Model &model, const spin_gltf_clip &clip)
{
    static const spin_gltf_attribute time = {"time", 1, SPIN_GLTF_F32, false};
    uint64_t n_keys = static_cast<uint64_t>(clip.n_frames) + 1;
    uint64_t offset = clip.keys_offset;
    int input = add_accessor(model, time, n_keys, offset, 0);
    tinygltf::Animation animation;

    model.accessors.back().minValues.assign(1, 0.0);
    model.accessors.back().maxValues.assign(1, static_cast<float>(clip.n_frames / clip.fps));
    offset += 4 * n_keys;
    animation.name = "frames";
    for (int f = 0; f < clip.n_frames; f++) {
        tinygltf::AnimationSampler sampler;
        tinygltf::AnimationChannel channel;

        sampler.input = input;
        sampler.output = add_output(model, clip, n_keys, offset);
        sampler.interpolation = "STEP";
        channel.sampler = f;
        aim(channel, clip, f);
        animation.samplers.push_back(sampler);
        animation.channels.push_back(channel);
    }
    model.animations.push_back(animation);
}

std::string text_of(const spin_gltf_clip &clip)
{
    tinygltf::Model model;
    tinygltf::TinyGLTF writer;
    std::ostringstream stream;
    std::string text;
    Value::Object extras = object_of(clip.extras);

    if (clip.fps > 0)
        extras["fps"] = Value(clip.fps);
    extras["frames"] = Value(clip.n_frames);
    model.asset.version = "2.0";
    model.asset.generator = clip.generator;
    model.asset.extras = Value(extras);
    add_nodes(model, clip);
    if (clip.animated)
        add_animation(model, clip);
    if (!model.meshes.empty())
        model.extensionsUsed.push_back(clip.extension);
    if (clip.animated && clip.visibility) {
        model.extensionsUsed.push_back(VISIBILITY);
        model.extensionsUsed.push_back(POINTER);
    }
    writer.WriteGltfSceneToStream(&model, stream, false, false);
    text = stream.str();
    while (!text.empty() && text.back() != '}')
        text.pop_back();
    /* A pointer has no node, but tinygltf always writes one. Within a string the quotes would have
     * backslashes. */
    for (size_t at = 0; (at = text.find("\"node\":-1,", at)) != std::string::npos;)
        text.erase(at, std::strlen("\"node\":-1,"));
    if (clip.n_bytes > 0)
        text.insert(1, "\"buffers\":[{\"byteLength\":" + std::to_string(clip.n_bytes) + "}],");
    return text;
}

int json(const spin_gltf_clip *clip, char **text, size_t *n, char *why, size_t n_why) noexcept
{
    try {
        std::string made = text_of(*clip);

        *n = made.size();
        *text = static_cast<char *>(std::malloc(made.size() + 1));
        if (*text)
            std::memcpy(*text, made.c_str(), made.size() + 1);
        else
            std::snprintf(why, n_why, "not enough memory");
        return *text != nullptr;
    } catch (const std::exception &e) {
        std::snprintf(why, n_why, "%s", e.what());
    } catch (...) {
        std::snprintf(why, n_why, "unknown failure");
    }
    return 0;
}

} // namespace

const struct spin_gltf_shim spin_gltf_shim_table = {SPIN_GLTF_SHIM_ABI, json};
