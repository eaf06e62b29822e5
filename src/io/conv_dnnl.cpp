/* The far side of conv.c: oneDNN behind a table of C functions (conv_shim.h).
 *
 * oneDNN chooses how it wants pictures and weights laid out; weights are brought into that order once,
 * pictures at every run. Versions 2 and 3 differ in how a primitive is described. */
#include "io/conv_shim.h"

#include <cstdio>
#include <cstring>
#include <exception>
#include <memory>

#include <oneapi/dnnl/dnnl.hpp>
#if DNNL_CPU_RUNTIME == DNNL_RUNTIME_OMP
#include <omp.h>
#endif

#define TEXT(v) #v
#define VERSION(a, b, c) TEXT(a) "." TEXT(b) "." TEXT(c)

namespace
{

using dnnl::memory;
using tag = dnnl::memory::format_tag;

memory::desc floats(const memory::dims &dims, tag layout)
{
    return memory::desc(dims, memory::data_type::f32, layout);
}

struct plan {
    dnnl::engine engine;
    dnnl::stream stream;
    dnnl::convolution_forward::primitive_desc chosen;
    dnnl::convolution_forward conv;
    memory in, out;           /* in plain order; their bytes are the caller's */
    memory own_in, own_out;   /* in oneDNN's order; empty where that is the plain one */
    memory weights, bias;     /* in oneDNN's order */
    dnnl::reorder into, back; /* */
    bool reorders_in, reorders_out;
    int n_threads;
};

dnnl::convolution_forward::primitive_desc choose(const dnnl::engine &engine,
                                                 const spin_conv_shape &s, const memory::dims &in,
                                                 const memory::dims &out)
{
    memory::dims weights = {s.n_out, s.n_in, s.kernel, s.kernel};
    memory::dims stride = {s.stride, s.stride}, pad = {s.pad, s.pad};
    auto from = floats(in, tag::any), to = floats(out, tag::any);
    auto w = floats(weights, tag::any), b = floats({s.n_out}, tag::x);
    auto kind = dnnl::prop_kind::forward_inference;
    auto algorithm = dnnl::algorithm::convolution_direct;
    dnnl::post_ops relu;
    dnnl::primitive_attr attr;

#if DNNL_VERSION_MAJOR >= 3
    relu.append_eltwise(dnnl::algorithm::eltwise_relu, 0.0f, 0.0f);
    attr.set_post_ops(relu);
    return {engine, kind, algorithm, from, w, b, to, stride, pad, pad, attr};
#else
    relu.append_eltwise(1.0f, dnnl::algorithm::eltwise_relu, 0.0f, 0.0f);
    attr.set_post_ops(relu);
    return {{kind, algorithm, from, w, b, to, stride, pad, pad}, attr, engine};
#endif
}

plan *make(const spin_conv_shape &s, const float *weights, const float *bias, int n_threads)
{
    int height = (s.height + 2 * s.pad - s.kernel) / s.stride + 1;
    int width = (s.width + 2 * s.pad - s.kernel) / s.stride + 1;
    memory::dims in = {1, s.n_in, s.height, s.width}, out = {1, s.n_out, height, width};
    std::unique_ptr<plan> p(new plan());
    memory given;

    p->n_threads = n_threads;
    p->engine = dnnl::engine(dnnl::engine::kind::cpu, 0);
    p->stream = dnnl::stream(p->engine);
    p->chosen = choose(p->engine, s, in, out);
    p->conv = dnnl::convolution_forward(p->chosen);
    p->in = memory(floats(in, tag::nchw), p->engine, nullptr);
    p->out = memory(floats(out, tag::nchw), p->engine, nullptr);
    p->reorders_in = p->chosen.src_desc() != p->in.get_desc();
    p->reorders_out = p->chosen.dst_desc() != p->out.get_desc();
    if (p->reorders_in) {
        p->own_in = memory(p->chosen.src_desc(), p->engine);
        p->into = dnnl::reorder(p->in, p->own_in);
    }
    if (p->reorders_out) {
        p->own_out = memory(p->chosen.dst_desc(), p->engine);
        p->back = dnnl::reorder(p->own_out, p->out);
    }
    p->bias = memory(floats({s.n_out}, tag::x), p->engine);
    std::memcpy(p->bias.get_data_handle(), bias, (size_t)s.n_out * sizeof *bias);
    given = memory(floats({s.n_out, s.n_in, s.kernel, s.kernel}, tag::oihw), p->engine,
                   const_cast<float *>(weights));
    p->weights = memory(p->chosen.weights_desc(), p->engine);
    dnnl::reorder(given, p->weights).execute(p->stream, given, p->weights);
    p->stream.wait();
    return p.release();
}

void use_threads(int n_threads)
{
#if DNNL_CPU_RUNTIME == DNNL_RUNTIME_OMP
    if (n_threads > 0)
        omp_set_num_threads(n_threads);
#else
    (void)n_threads;
#endif
}

void work(plan &p, const float *in, float *out)
{
    p.in.set_data_handle(const_cast<float *>(in));
    p.out.set_data_handle(out);
    if (p.reorders_in)
        p.into.execute(p.stream, p.in, p.own_in);
    p.conv.execute(p.stream, {{DNNL_ARG_SRC, p.reorders_in ? p.own_in : p.in},
                              {DNNL_ARG_WEIGHTS, p.weights},
                              {DNNL_ARG_BIAS, p.bias},
                              {DNNL_ARG_DST, p.reorders_out ? p.own_out : p.out}});
    if (p.reorders_out)
        p.back.execute(p.stream, p.own_out, p.out);
    p.stream.wait();
}

void *open_plan(const struct spin_conv_shape *shape, const float *weights, const float *bias,
                int n_threads, char *why, size_t n_why) noexcept
{
    try {
        use_threads(n_threads);
        return make(*shape, weights, bias, n_threads);
    } catch (const std::exception &e) {
        std::snprintf(why, n_why, "%s", e.what());
    } catch (...) {
        std::snprintf(why, n_why, "unknown failure");
    }
    return nullptr;
}

int run_plan(void *it, const float *in, float *out, char *why, size_t n_why) noexcept
{
    try {
        use_threads(static_cast<plan *>(it)->n_threads);
        work(*static_cast<plan *>(it), in, out);
        return 1;
    } catch (const std::exception &e) {
        std::snprintf(why, n_why, "%s", e.what());
    } catch (...) {
        std::snprintf(why, n_why, "unknown failure");
    }
    return 0;
}

void drop_plan(void *it) noexcept { delete static_cast<plan *>(it); }

} // namespace

const struct spin_conv_shim spin_conv_shim_table = {
    SPIN_CONV_SHIM_ABI, VERSION(DNNL_VERSION_MAJOR, DNNL_VERSION_MINOR, DNNL_VERSION_PATCH),
    open_plan,          run_plan,
    drop_plan,
};
