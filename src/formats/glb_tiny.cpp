/* Creates the JSON of a .glb with tinygltf. The binary data are not passed to tinygltf, which would
 * copy them. Without data, tinygltf cannot compute the length of the buffer, so the array "buffers"
 * is inserted into the text afterwards. */
#include "formats/glb_shim.h"

#include <cstdio>
#include <cstring>
#include <new>
#include <sstream>
#include <string>

#include <tiny_gltf.h>

namespace
{

using tinygltf::Value;

#define SPLATS "KHR_gaussian_splatting"

/* Replaces all characters other than printable ASCII by underscores, since JSON must be valid
 * UTF-8, and texts that come from files may not be. */
std::string plain(const char *text)
{
    std::string out(text);

    for (char &c : out)
        if (c < 32 || c > 126)
            c = '_';
    return out;
}

/* Adds an accessor and a buffer view for it. Returns the index of the accessor. */
int add_accessor(tinygltf::Model &model, int components, bool is_u16, uint64_t n, uint64_t offset,
                 int target)
{
    static const int types[] = {0, TINYGLTF_TYPE_SCALAR, 0, TINYGLTF_TYPE_VEC3, TINYGLTF_TYPE_VEC4};
    tinygltf::BufferView view;
    tinygltf::Accessor accessor;

    view.buffer = 0;
    view.byteOffset = offset;
    view.byteLength = n * static_cast<size_t>(components) * (is_u16 ? 2 : 4);
    view.target = target;
    model.bufferViews.push_back(view);
    accessor.bufferView = static_cast<int>(model.bufferViews.size()) - 1;
    accessor.componentType =
        is_u16 ? TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT : TINYGLTF_COMPONENT_TYPE_FLOAT;
    accessor.normalized = is_u16;
    accessor.count = n;
    accessor.type = types[components];
    model.accessors.push_back(accessor);
    return static_cast<int>(model.accessors.size()) - 1;
}

/* Adds an accessor for each column, with the same index. */
void add_columns(tinygltf::Model &model, const spin_glb_clip &clip)
{
    for (size_t i = 0; i < clip.n_columns; i++) {
        const spin_glb_column &c = clip.column[i];

        add_accessor(model, clip.components[c.attribute], c.attribute == clip.n_attributes - 1, c.n,
                     c.offset, TINYGLTF_TARGET_ARRAY_BUFFER);
        if (c.attribute > 0)
            continue;
        model.accessors.back().minValues.assign(c.low, c.low + 3);
        model.accessors.back().maxValues.assign(c.high, c.high + 3);
    }
}

int add_mesh(tinygltf::Model &model, const spin_glb_clip &clip, const spin_glb_frame &frame)
{
    tinygltf::Primitive primitive;
    tinygltf::Mesh mesh;

    primitive.mode = TINYGLTF_MODE_POINTS;
    primitive.extensions[SPLATS] =
        Value(Value::Object{{"kernel", Value(std::string("ellipse"))},
                            {"colorSpace", Value(std::string("srgb_rec709_display"))}});
    for (int a = 0; a < clip.n_attributes; a++)
        primitive.attributes[clip.name[a]] = static_cast<int>(frame.column[a]);
    mesh.primitives.push_back(primitive);
    model.meshes.push_back(mesh);
    return static_cast<int>(model.meshes.size()) - 1;
}

void add_nodes(tinygltf::Model &model, const spin_glb_clip &clip)
{
    tinygltf::Scene scene;

    for (int f = 0; f < clip.n_frames; f++) {
        const spin_glb_frame &frame = clip.frame[f];
        tinygltf::Node node;

        node.name = "frame_" + std::to_string(frame.number);
        node.extras =
            Value(Value::Object{{"frame", Value(frame.number)}, {"time", Value(frame.time)}});
        if (frame.n > 0)
            node.mesh = add_mesh(model, clip, frame);
        if (clip.animated) /* viewers that ignore animations show only frame 0 */
            node.scale.assign(3, f == 0 ? 1.0 : 0.0);
        model.nodes.push_back(node);
        scene.nodes.push_back(f);
    }
    if (clip.still && clip.still->n > 0) {
        tinygltf::Node node;

        node.name = "still";
        node.mesh = add_mesh(model, clip, *clip.still);
        model.nodes.push_back(node);
        scene.nodes.insert(scene.nodes.begin(), clip.n_frames);
    }
    model.scenes.push_back(scene);
    model.defaultScene = 0;
}

void add_animation(tinygltf::Model &model, const spin_glb_clip &clip, uint64_t at)
{
    uint64_t n = static_cast<uint64_t>(clip.n_frames) + 1;
    int input = add_accessor(model, 1, false, n, at, 0);
    tinygltf::Animation animation;

    model.accessors.back().minValues.assign(1, 0.0);
    model.accessors.back().maxValues.assign(1, static_cast<float>(clip.n_frames / clip.fps));
    at += 4 * n;
    animation.name = "frames";
    for (int f = 0; f < clip.n_frames; f++, at += 12 * n) {
        tinygltf::AnimationSampler sampler;
        tinygltf::AnimationChannel channel;

        sampler.input = input;
        sampler.output = add_accessor(model, 3, false, n, at, 0);
        sampler.interpolation = "STEP";
        channel.sampler = f;
        channel.target_node = f;
        channel.target_path = "scale";
        animation.samplers.push_back(sampler);
        animation.channels.push_back(channel);
    }
    model.animations.push_back(animation);
}

std::string text_of(const spin_glb_clip &clip, const char *generator, uint64_t keys)
{
    tinygltf::Model model;
    tinygltf::TinyGLTF writer;
    std::ostringstream stream;
    std::string text;
    Value::Object extras{{"axes", Value(plain(clip.axes))}, {"frames", Value(clip.n_frames)}};

    if (clip.source && *clip.source)
        extras["source"] = Value(plain(clip.source));
    if (clip.fps > 0)
        extras["fps"] = Value(clip.fps);
    if (clip.antialias)
        extras["antialias"] = Value(true);
    model.asset.version = "2.0";
    model.asset.generator = generator;
    model.asset.extras = Value(extras);
    add_columns(model, clip);
    add_nodes(model, clip);
    if (clip.animated)
        add_animation(model, clip, keys);
    if (!model.meshes.empty())
        model.extensionsUsed.push_back(SPLATS);
    writer.WriteGltfSceneToStream(&model, stream, false, false);
    text = stream.str();
    while (!text.empty() && text.back() != '}')
        text.pop_back();
    if (clip.n_bytes > 0)
        text.insert(1, "\"buffers\":[{\"byteLength\":" + std::to_string(clip.n_bytes) + "}],");
    return text;
}

char *text(const spin_glb_clip *clip, const char *generator, uint64_t keys, char *why,
           size_t n_why) noexcept
{
    try {
        return strdup(text_of(*clip, generator, keys).c_str());
    } catch (const std::bad_alloc &) {
        *why = '\0';
    } catch (const std::exception &e) {
        std::snprintf(why, n_why, "%s", e.what());
    } catch (...) {
        std::snprintf(why, n_why, "unknown failure");
    }
    return nullptr;
}

} // namespace

const struct spin_glb_shim spin_glb_shim_table = {SPIN_GLB_SHIM_ABI, text};
