# spin4d: every build, test and check. `make help` lists the targets.
#
# Knobs: CONFIG=release|debug|asan|ubsan|tsan|cov (each in its own folder of BUILD)
#        V=1 (show commands)  K=words (tests to run)  SETUP=0 (do not install packages)
#        BUILD=build (output folder; or call make -f /path/to/spin4d/Makefile from any folder)
#        CC=clang CXX= CPPFLAGS= CFLAGS= CXXFLAGS= LDFLAGS= (appended to those that spin4d needs)
#        PREFIX=/usr/local  LIBDIR=PREFIX/lib  DESTDIR=
#        PYTHON=/usr/bin/python3 (install the module for it)  PYTHONDIR= (or into this folder)
#        RUN='qemu-aarch64 -L /usr/aarch64-linux-gnu' (emulator for cross-compiled programs)
# Private settings go into an untracked local.mk.
comma := ,
HERE := $(patsubst %/,%,$(dir $(realpath $(firstword $(MAKEFILE_LIST)))))
ifneq ($(HERE),$(CURDIR))
# Called from another folder: build into the build/ of that folder.
BUILD   ?= build
.PHONY: all
$(sort all $(MAKECMDGOALS)): elsewhere ; @:
.PHONY: elsewhere
elsewhere: ; @$(MAKE) --no-print-directory -C $(HERE) BUILD=$(abspath $(BUILD)) $(MAKECMDGOALS)
else
-include local.mk

CONFIG  ?= release
PREFIX  ?= /usr/local
LIBDIR  ?= $(PREFIX)/lib
BUILD   ?= build
B       := $(BUILD)/$(CONFIG)
SETUP   ?= 1
JOBS    ?= $(shell nproc 2>/dev/null || echo 2)
CXX     ?= g++
ifeq ($(origin CC),default)
CC      := gcc
endif
Q   := $(if $(filter 1,$(V)),,@)
SAY := @printf '  %-8s %s\n'
ifneq ($(filter 1,$(V))$(findstring s,$(filter-out --%,$(firstword -$(MAKEFLAGS)))),)
SAY := @:
endif
VERSION := $(shell sed -n 's/^\#define SPIN_VERSION "\(.*\)"/\1/p' src/spin.h)
# Raise it if programs linked with the previous shared library would not run with the new one.
SOVERSION := 0

OPT.release := -O3 -DNDEBUG
OPT.debug   := -O1
# Undefined behaviour traps, and AddressSanitizer reports the location. Messages for each case would
# make the commands 60 % larger and double their start-up time; CONFIG=ubsan has them.
OPT.asan    := -Og -Wno-format-truncation -fsanitize=address,undefined -fsanitize-undefined-trap-on-error -fno-omit-frame-pointer
OPT.ubsan   := -O1 -fsanitize=undefined -fno-sanitize-recover=undefined
OPT.tsan    := -O1 -fsanitize=thread
OPT.cov     := -O0 --coverage
OPT         := $(OPT.$(CONFIG))
# -g1 has line numbers but no variables, for which gcc takes up to six times as long with a
# sanitiser, and the linker twice as long. -Og compiles in half the time of -O1, but gives false
# warnings about truncated formats.
LINES       := $(if $(filter debug,$(CONFIG)),-g,-g1)
ifeq ($(OPT),)
$(error CONFIG=$(CONFIG) is not one of release debug asan ubsan tsan cov)
endif

# Flags that spin4d needs; the user's are appended. Absolute paths are kept out of the output.
WARN          := -Wall -Wextra -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla -Werror=vla
PREFIX_MAP    := -ffile-prefix-map=$(CURDIR)=. $(if $(filter /%,$(BUILD)),-ffile-prefix-map=$(BUILD)=build)
SPIN_CPPFLAGS := -Isrc -I. -D_GNU_SOURCE
MACHINE       := $(shell $(CC) -dumpmachine)
WASM          := $(filter wasm%,$(MACHINE))
SPIN_CFLAGS   := -std=gnu11 $(OPT) $(WARN) -fno-trapping-math -fno-math-errno $(if $(WASM),,$(LINES) -fPIC -pthread) $(PREFIX_MAP)
SPIN_CXXFLAGS := -std=c++17 -O2 $(if $(WASM),,-g1 -fPIC) -Wall -Wextra $(PREFIX_MAP)
SPIN_LDFLAGS  := $(filter -fsanitize%,$(OPT)) $(filter --coverage,$(OPT)) -pthread
SPIN_LDLIBS   := -lz -llzma -ljansson -ldl -lm
# AddressSanitizer intercepts exceptions of shims only if libstdc++ is loaded at start-up.
SPIN_LDLIBS   += $(if $(filter asan,$(CONFIG)),-Wl$(comma)--no-as-needed -lstdc++)
SPIN_DEFINES  :=
COMPILE_C      = $(CC) $(SPIN_CPPFLAGS) $(CPPFLAGS) $(SPIN_DEFINES) $(SPIN_CFLAGS) $(QUICK) $(HOT) $(CONTRACT) $(CFLAGS)
# Shims in C are compiled without sanitisers.
COMPILE_SHIM   = $(SPIN_CPPFLAGS) $(CPPFLAGS) $(filter-out -fsanitize%,$(SPIN_CFLAGS)) $(CFLAGS) $(LDFLAGS)
COMPILE_CXX    = $(CXX) $(SPIN_CPPFLAGS) $(CPPFLAGS) $(SPIN_CXXFLAGS) $(CXXFLAGS) $(LDFLAGS)
LINK           = $(CC) $(SPIN_LDFLAGS) $(CFLAGS) $(LDFLAGS)

# The CPU device is compiled once per SIMD path; device.c selects one at run time.
PATHS    := base
ifneq ($(filter x86_64-%,$(MACHINE)),)
PATHS    := base v3 v4
endif
FLAGS.base :=
# The flags of -march=x86-64-v3 and -v4, which gcc 10 does not support.
FLAGS.v3   := -march=x86-64 -mtune=generic -mcx16 -msahf -mpopcnt -msse4.2 -mavx2 -mbmi -mbmi2 -mf16c -mfma -mlzcnt \
              -mmovbe -mxsave
FLAGS.v4   := $(FLAGS.v3) -mavx512f -mavx512bw -mavx512cd -mavx512dq -mavx512vl -mprefer-vector-width=512

ROOMS    := src/base src/io src/formats src/scene src/geometry src/model src/render src/train src/eval src/eval/report src/run importers importers/lib \
            exporters exporters/lib
LIB_C    := $(filter-out src/io/video%ffmpeg.c src/io/ranks_mpi.c src/io/image_plain.c $(if $(WASM),src/base/shim.c),$(sort $(wildcard $(addsuffix /*.c,$(ROOMS))))) src/device/device.c
CPU_C    := $(sort $(wildcard src/device/cpu/*.c))
LIB_O    := $(LIB_C:%.c=$(B)/%.o) $(addprefix $(B)/,exporters/html_page.o src/eval/report/page.o src/eval/report/compare_html.o src/run/watch_html.o) $(foreach p,$(PATHS),$(CPU_C:%.c=$(B)/%.$(p).o))
CMD_O    := $(patsubst %.c,$(B)/%.o,$(filter-out src/cmd/spin%,$(sort $(wildcard src/cmd/*.c))))
COMMANDS := spin4d spin-import spin-retrain spin-export spin-eval
BINS     := $(COMMANDS:%=$(B)/bin/%)
LIB      := $(B)/libspin.a
LIB_SO   := $(B)/libspin.so.$(VERSION)
SHIMS    := $(B)/lib/spin-image.so $(B)/lib/spin-image-plain.so $(B)/lib/spin-gltf.so

# Support for several machines needs MPI; MPICC= disables it.
MPICC    ?= $(shell command -v mpicc)
ifneq ($(MPICC),)
SHIMS    += $(B)/lib/spin-mpi.so
endif

TOOLS    := $(B)/tests/tools/compare-images

# Videos need FFmpeg, which `make setup-video` installs; VIDEO=no disables them.
VIDEO    ?= $(shell printf '\043if __has_include(<libavformat/avformat.h>) && __has_include(<libavcodec/avcodec.h>)\nyes\n\043endif\n' | \
            $(CC) $(SPIN_CPPFLAGS) $(CPPFLAGS) -E -P -x c - 2>/dev/null)
ifneq ($(filter yes,$(VIDEO)),)
SHIMS    += $(B)/lib/spin-video.so
TOOLS    += $(B)/tests/tools/make-video $(B)/tests/tools/read-sound
endif

# The CUDA device needs nvcc (CUDA=1: fail without it; 0: leave it out). One shared object supports
# all GPUs from sm_75 on: cubins for the listed architectures, and PTX of these and of sm_75 for all
# others. It is loaded only when requested.
CUDA      ?= auto
CUDA_ARCH ?= 80 90 120
NVCC      ?= $(shell command -v nvcc 2>/dev/null)
CUDA_CU   := $(sort $(wildcard src/device/cuda/*.cu))
ifeq ($(CUDA),1)
ifeq ($(NVCC),)
$(error CUDA=1 needs nvcc in PATH, or NVCC=/path/to/nvcc)
endif
endif
ifneq ($(filter auto 1,$(CUDA)),)
ifneq ($(NVCC),)
ifneq ($(filter release debug,$(CONFIG)),)
SHIMS    += $(B)/lib/spin-cuda.so
endif
endif
endif

EMU      := $(patsubst %,$(B)/tests/emu/%.so,spin-cuda spin-cuda-race faults faults-race)
TEST_C   := $(wildcard tests/*/t-*.c)
TEST_BIN := $(TEST_C:%.c=$(B)/%)
UNIT_BIN := $(filter-out $(B)/tests/cmd/% $(B)/tests/emu/%,$(TEST_BIN))
# clip.c is a separate program, which export.sh runs.
BENCH_C  := $(filter-out tests/bench/clip.c,$(wildcard tests/bench/*.c))
BENCH_O  := $(BENCH_C:%.c=$(B)/%.o)
BENCH    := $(B)/tests/bench/bench
FUZZ_C   := $(wildcard tests/fuzz/fuzz-*.c)

.PHONY: all help config setup setup-video setup-lint demo quick test test-bins room-bins test-tools test-builds test-card card-kit test-ranks check lint mutants changes test-viewers bench-viewers results pictures hero valgrind tsan fuzz fuzz-replay bench install uninstall wheel portable web windows dist deb clean format
.SECONDARY:
.DELETE_ON_ERROR:

all: $(BINS) $(LIB_SO) $(SHIMS) $(if $(filter build,$(BUILD)),bin) ## both libraries and the commands (default)

help: ## list targets and variables
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{printf "%-22s %s\n", $$1, $$2}'
	@sed -n '/^# Knobs:/,/^# Private/ s/^# *//p' Makefile

config: ## report which compilers and libraries were found
	@sh tests/setup.sh --report "$(CC)" "$(CXX)"
	@echo "cpu paths:   $(PATHS)"

setup: ## install packages that building and testing need (Debian/Ubuntu), or print the command
	@sh tests/setup.sh --tests

setup-video: ## install FFmpeg's libraries, for videos as input and output
	@sh tests/setup.sh --video

setup-lint: ## install clang, which the lint of device pointers needs
	@sh tests/setup.sh --lint

demo: ## import, retrain, evaluate and export the bundled clip; under five minutes
	@[ "$(SETUP)" = 0 ] || sh tests/setup.sh
	@$(MAKE) --no-print-directory -j$(JOBS) all
	@sh tests/demo.sh $(B)/bin

quick: ## the unit tests, in a minute: run them after every change
	@$(MAKE) --no-print-directory test K=$@

# Packages that only tests need are installed, or attempted to be, once; `make setup` tries again.
test: ## all tests except test-card and test-ranks, JOBS in parallel; K='words' selects; SETUP=0: no packages
	@[ "$(SETUP)" = 0 ] || sh tests/setup.sh $(if $(wildcard $(BUILD)/test-needs),,--tests)
	@[ "$(SETUP)" = 0 ] || { mkdir -p $(BUILD) && touch $(BUILD)/test-needs; }
	@$(MAKE) --no-print-directory -j$(JOBS) all $(if $(filter quick,$(K)),$(UNIT_BIN),test-bins)
	@JOBS=$(JOBS) sh tests/run.sh $(B) "$(K)"

test-bins: room-bins $(EMU) $(TEST_BIN) $(BENCH) $(B)/tests/bench/clip
# The tests that .ci/run runs under sanitisers: all except those of the emulated GPU, tests/cmd and
# tests/bench.
room-bins: $(UNIT_BIN) $(filter $(B)/tests/emu/%,$(TEST_BIN)) test-tools fuzz-bins
test-tools: $(TOOLS)

test-card: ## trainings on the emulated GPU, which `make test` omits
	@$(MAKE) --no-print-directory test K=$@

card-kit: all test-bins ## BUILD/spin4d-card.tar.xz: tests for a machine with a GPU and few packages, see docs/accelerator.md
	@sh tests/card/pack.sh $(B) $(BUILD)

test-ranks: ## trainings by many processes, which `make test` omits
	@$(MAKE) --no-print-directory test K=$@

test-builds: ## K='gcc clang paths bytes deb arm64 web windows': other compilers, SIMD paths and packages
	@sh tests/builds.sh $(BUILD) $(K)

bin:
	@ln -sfn $(B)/bin bin

$(LIB): $(LIB_O)
	$(SAY) AR $@
	$(Q)rm -f $@ && $(AR) rcsD $@ $(LIB_O)

# The shared library exports only what the public headers declare.
$(LIB_SO): $(LIB_O) src/spin.h src/spin_train.h src/spin_run.h
	$(SAY) LINK $@
	$(Q){ echo '{ global: spin_importers; spin_exporters;'; \
	    $(CC) $(SPIN_CPPFLAGS) -E -P src/spin_run.h | grep -o 'spin_[a-z0-9_]*(' | sort -u | tr '(' ';'; \
	    echo 'local: *; };'; } >$(B)/libspin.map
	$(Q)$(LINK) -shared -Wl,-soname,libspin.so.$(SOVERSION) -Wl,--version-script=$(B)/libspin.map \
	    -o $@ $(LIB_O) $(SPIN_LDLIBS) $(LDLIBS)

# The functions that a plug-in may call are linked into every command and exported; no others are.
PLUGIN_SYM := src/plugin.sym
PLUGIN_LD  := -Wl,--dynamic-list=$(PLUGIN_SYM) \
              $(shell sed -n 's/^ *\(spin_[a-z_]*\);$$/-Wl,-u,\1/p' $(PLUGIN_SYM))

# The commands of `make portable` find all libraries, including indirect ones, in lib/spin4d beside
# their bin/. The libraries that they need to start are linked statically, since the loader finds
# that folder without /proc only if they have restarted with LD_ORIGIN_PATH set.
STATIC_LIBS := -l:libz.a -l:liblzma.a -l:libjansson.a
define COMMAND_RULE
$(B)$(1)/bin/%: $(B)/src/cmd/%.o $(CMD_O) $(LIB) $(PLUGIN_SYM)
	@mkdir -p $$(@D)
	$(SAY) LINK $$@
	$(Q)$(LINK) $(PLUGIN_LD) $(2) -o $$@ $(B)/src/cmd/$$*.o $(CMD_O) $(LIB) $(3) $(SPIN_LDLIBS) $(LDLIBS)
endef
$(eval $(call COMMAND_RULE))
$(eval $(call COMMAND_RULE,/portable,-Wl$(comma)--disable-new-dtags -Wl$(comma)-rpath$(comma)'$$$$ORIGIN/../lib/spin4d',$(STATIC_LIBS)))

# Pages as C strings, without indentation and comment lines.
C_STRING := sed -e 's/^ *//' -e '/^\/\//d' -e 's/\\/\\\\/g' -e 's/"/\\"/g' -e 's/??/?\\?/g' -e 's/^/    "/' -e 's/$$/\\n"/'
$(B)/src/eval/report/page.c: src/eval/report/page.html Makefile
	@mkdir -p $(@D)
	$(SAY) PAGE $@
	$(Q){ echo 'extern const char spin_report_page[]; const char spin_report_page[] ='; $(C_STRING) $<; echo '    ;'; } >$@
$(B)/src/eval/report/compare_html.c: src/eval/report/compare.html Makefile
	@mkdir -p $(@D)
	$(SAY) PAGE $@
	$(Q){ echo 'extern const char spin_compare_html[]; const char spin_compare_html[] ='; $(C_STRING) $<; echo '    ;'; } >$@
$(B)/src/run/watch_html.c: src/run/watch.html Makefile
	@mkdir -p $(@D)
	$(SAY) PAGE $@
	$(Q){ echo 'extern const char spin_watch_html[]; const char spin_watch_html[] ='; $(C_STRING) $<; echo '    ;'; } >$@
$(B)/src/eval/report/page.o $(B)/src/eval/report/compare_html.o $(B)/src/run/watch_html.o: %.o: %.c
	$(SAY) CC $@
	$(Q)$(COMPILE_C) -c -o $@ $<

# Import and export in a browser: one self-contained page. The nested make uses emscripten as the
# compiler, which needs the path of Debian's node modules.
WEB := $(BUILD)/web
web: ## BUILD/web/spin4d.html: import and export in a browser, built with emscripten
	@sh src/web/deps.sh $(WEB)
	@NODE_PATH=/usr/share/nodejs $(MAKE) --no-print-directory B=$(WEB) CC=emcc CXX=em++ AR=emar MPICC= VIDEO=no CUDA=0 CONFIG=release \
	    CPPFLAGS=-I$(WEB)/usr/include LDFLAGS=-L$(WEB)/usr/lib CFLAGS= CXXFLAGS= $(WEB)/spin4d.html
$(WEB)/src/web/spin-%.o: src/cmd/spin-%.c
	@mkdir -p $(@D)
	$(SAY) CC $@
	$(Q)$(COMPILE_C) -Dmain=spin_$*_main -Wno-missing-prototypes -c -o $@ $<
$(WEB)/src/web/glb_tiny.o: src/formats/glb_tiny.cpp src/formats/glb_shim.h
	@mkdir -p $(@D)
	$(SAY) CXX $@
	$(Q)$(COMPILE_CXX) -DTINYGLTF_IMPLEMENTATION -DTINYGLTF_NO_STB_IMAGE -DTINYGLTF_NO_STB_IMAGE_WRITE -c -o $@ $<
WEB_O := $(addprefix $(WEB)/src/web/,main.o shim.o spin-import.o spin-export.o glb_tiny.o)
$(WEB)/spin4d.js: $(WEB_O) $(CMD_O) $(LIB)
	$(SAY) LINK $@
	$(Q)$(CXX) -O3 $(LDFLAGS) -o $@ $^ -lz -llzma -ljansson -lwebp -lzstd -lworkerfs.js -sSINGLE_FILE -sMODULARIZE \
	    -sEXPORT_NAME=spin4d -sINVOKE_RUN=0 -sENVIRONMENT=web,worker,node -sALLOW_MEMORY_GROWTH -sMAXIMUM_MEMORY=4GB \
	    -sTOTAL_STACK=4MB -sEXPORTED_RUNTIME_METHODS=callMain,FS,WORKERFS
$(WEB)/spin4d.html: $(WEB)/spin4d.js src/web/page.html src/web/page.js src/web/worker.js Makefile
	$(SAY) PAGE $@
	$(Q){ cat src/web/page.html; \
	    echo '<script type="text/plain" id="worker">'; cat $(WEB)/spin4d.js src/web/worker.js; echo '</script>'; \
	    echo '<script>'; cat src/web/page.js; echo '</script>'; echo '</body>'; echo '</html>'; } >$@

# The page of the html exporter, as one string per file.
PAGE := head:head.html css:page.css body:body.html project:project.frag vertex:shader.vert fragment:shader.frag \
        worker:worker.js script:page.js
$(B)/exporters/html_page.c: $(addprefix exporters/html/,$(foreach p,$(PAGE),$(lastword $(subst :, ,$(p))))) Makefile
	@mkdir -p $(@D)
	$(SAY) PAGE $@
	$(Q){ echo '#include "exporters/html/page.h"'; for p in $(PAGE); do \
	    echo "const char spin_html_$${p%%:*}[] ="; \
	    $(C_STRING) exporters/html/$${p#*:}; \
	    echo '    ;'; done; } >$@
$(B)/exporters/html_page.o: $(B)/exporters/html_page.c exporters/html/page.h
	$(SAY) CC $@
	$(Q)$(COMPILE_C) -c -o $@ $<

# The player as a package: its files, and the page without a clip, which plays .sogst files.
PLAYER := $(patsubst exporters/player/%,$(B)/player/%,$(filter-out %/sogst.js,$(wildcard exporters/player/*))) $(B)/player/view.html
$(B)/player/view.html: $(addprefix exporters/html/,$(foreach p,$(PAGE),$(lastword $(subst :, ,$(p))))) exporters/player/sogst.js Makefile
	@mkdir -p $(@D)
	$(SAY) PAGE $@
	$(Q){ cat exporters/html/head.html; echo '<title>Clip</title>'; echo '<style>'; cat exporters/html/page.css exporters/html/body.html; \
	    echo '<script type="application/json" id="clip"></script>'; \
	    for p in worker:worker.js project:project.frag vertex:shader.vert fragment:shader.frag page:page.js; do \
	    echo "<script type=\"text/plain\" id=\"$${p%%:*}\">"; cat exporters/html/$${p#*:}; echo '</script>'; done; \
	    echo '<script>'; cat exporters/player/sogst.js; echo '</script>'; echo '</body>'; echo '</html>'; } >$@
all: $(PLAYER)
$(B)/player/%: exporters/player/%
	@mkdir -p $(@D)
	$(Q)cp $< $@

# Shims: wrappers of libraries are separate shared objects, loaded only when needed. Commands refuse
# shims that others can write to, so remove the permissions that umask may leave to the group.
SHIM_DONE = $(Q)chmod go-w $(@D) $@
# Shims in C++ are built without sanitisers, and hence once for all CONFIGs.
$(BUILD)/shims/spin-image.so: src/io/image_oiio.cpp src/io/image_shim.h
$(BUILD)/shims/spin-image.so: LIBS := -lOpenImageIO -lOpenImageIO_Util
$(BUILD)/shims/spin-gltf.so: src/formats/glb_tiny.cpp src/formats/glb_shim.h
$(BUILD)/shims/spin-gltf.so: LIBS := -ltinygltf
$(BUILD)/shims/%.so:
	@mkdir -p $(@D)
	$(SAY) SHIM $@
	$(Q)$(COMPILE_CXX) -shared -o $@ $< $(LIBS)
$(B)/lib/spin-image.so $(B)/lib/spin-gltf.so: $(B)/lib/%: $(BUILD)/shims/%
	@mkdir -p $(@D)
	$(Q)cp $< $@
	$(SHIM_DONE)

$(B)/lib/spin-image-plain.so: src/io/image_plain.c src/io/image_shim.h
	@mkdir -p $(@D)
	$(SAY) SHIM $@
	$(Q)$(CC) $(COMPILE_SHIM) -shared -o $@ $< -ljpeg -lpng
	$(SHIM_DONE)

$(B)/lib/spin-mpi.so: src/io/ranks_mpi.c src/io/ranks_shim.h
	@mkdir -p $(@D)
	$(SAY) SHIM $@
	$(Q)OMPI_CC="$(CC)" MPICH_CC="$(CC)" $(MPICC) $(COMPILE_SHIM) -shared -o $@ $<
	$(SHIM_DONE)

FFMPEG   := -lavformat -lavcodec -lswscale -lswresample -lavutil -lm
$(B)/lib/spin-video.so: src/io/video_ffmpeg.c src/io/video_encode_ffmpeg.c src/io/video_sound_ffmpeg.c src/io/video_shim.h
	@mkdir -p $(@D)
	$(SAY) SHIM $@
	$(Q)$(CC) $(COMPILE_SHIM) -shared -o $@ $(filter %.c,$^) $(FFMPEG)
	$(SHIM_DONE)

$(B)/tests/tools/make-video $(B)/tests/tools/read-sound: $(B)/tests/tools/%: tests/tools/%.c
	@mkdir -p $(@D)
	$(SAY) LINK $@
	$(Q)$(CC) $(COMPILE_SHIM) -o $@ $< $(FFMPEG)

# CUDA kernels. Contraction to FMA is disabled where every operation must round as on the CPU, see
# below. C++14, whose headers compile in half the time of C++20's, except for CUB.
CU_STD     = -std=$(if $(filter %/gpu.cu,$<),c++17,c++14)
NVCCFLAGS := -O3 -DNDEBUG -Xcompiler -fPIC,-fvisibility=hidden -gencode arch=compute_75,code=compute_75 \
             $(foreach a,$(CUDA_ARCH),-gencode arch=compute_$a$(comma)code=[sm_$a$(comma)compute_$a]) -Xptxas -v
$(B)/src/device/cuda/contract.cu.o $(B)/src/device/cuda/grid.cu.o $(B)/src/device/cuda/lazy_adam.cu.o: FMAD := -fmad=false
$(B)/%.cu.o: %.cu
	@mkdir -p $(@D)
	$(SAY) NVCC $<
	$(Q)$(NVCC) $(CU_STD) $(SPIN_CPPFLAGS) $(CPPFLAGS) $(NVCCFLAGS) $(FMAD) -MMD -MP -MF $(@:.o=.d) -c -o $@ $< 2>$@.log || { cat $@.log >&2; exit 1; }
$(B)/lib/spin-cuda.so: $(CUDA_CU:%=$(B)/%.o)
	@mkdir -p $(@D)
	$(SAY) SHIM $@
	$(Q)$(NVCC) -cudart static -shared -o $@ $^
	$(SHIM_DONE)

# The same kernels for the host, in the emulation of tests/emu: with array bounds checked, and again
# with instrumentation for the race detector.
EMU_BASE  := -g1 -O2 -Wall -Wextra -fPIC -fvisibility=hidden -ffp-contract=off -DSPIN_EMU -Itests/emu -include tests/emu/emu.h
EMU_BOUND := -fsanitize=bounds -fno-sanitize-recover=bounds
EMU_FLAGS := $(EMU_BASE) $(if $(filter asan,$(CONFIG)),$(filter -f%,$(OPT)) -fsanitize-sections=emu_shared*,$(EMU_BOUND))
EMU_CU    := $(filter-out src/device/cuda/gpu.cu,$(sort $(wildcard src/device/cuda/*.cu)))
EMU_O     := $(B)/tests/emu/emu.o $(B)/tests/emu/gpu.o $(B)/tests/emu/norace.o
RACE_O    := $(B)/tests/emu/emu.o $(B)/tests/emu/gpu.o $(B)/tests/emu/race.o
RACE      := $(BUILD)/race
$(B)/tests/emu/emu.o $(B)/tests/emu/race.o: EMU_OPT := -O3
$(B)/tests/emu/%.o: tests/emu/%.cpp
	@mkdir -p $(@D)
	$(SAY) CXX $<
	$(Q)$(CXX) -std=c++17 $(SPIN_CPPFLAGS) $(EMU_FLAGS) $(EMU_OPT) -MMD -MP -c -o $@ $<
$(B)/%.emu.o: %.cu tests/emu/emu.h
	@mkdir -p $(@D)
	$(SAY) EMU $<
	$(Q)$(CXX) $(CU_STD) $(SPIN_CPPFLAGS) -x c++ $(EMU_FLAGS) -DEMU_SHARED=emu_shared_$(notdir $*) -MMD -MP -c -o $@ $<
# Identical in every CONFIG.
$(RACE)/%.race.o: %.cu tests/emu/emu.h
	@mkdir -p $(@D)
	$(SAY) RACE $<
	$(Q)$(CXX) $(CU_STD) $(SPIN_CPPFLAGS) -x c++ $(EMU_BASE) -DEMU_SHARED=emu_shared_$(notdir $*) $(EMU_BOUND) -fsanitize=thread -MMD -MP -c -o $@ $<
$(B)/tests/emu/t-emu: | $(B)/tests/emu/faults.so $(B)/tests/emu/faults-race.so
$(B)/tests/emu/spin-cuda.so: $(EMU_CU:%.cu=$(B)/%.emu.o) $(EMU_O)
$(B)/tests/emu/spin-cuda-race.so: $(EMU_CU:%.cu=$(RACE)/%.race.o) $(RACE_O)
$(B)/tests/emu/faults.so: $(B)/tests/emu/faults.emu.o $(EMU_O)
$(B)/tests/emu/faults-race.so: $(RACE)/tests/emu/faults.race.o $(RACE_O)
$(EMU):
	$(SAY) LINK $@
	$(Q)$(CXX) $(filter -fsanitize%,$(OPT)) -shared -pthread -o $@ $^

# The grid's vertex positions, the statistics of densification and the networks of importers round
# after every operation, so contraction to FMA is disabled and all SIMD paths give identical bits.
$(B)/src/device/cpu/contract.%.o $(B)/src/device/cpu/grid.%.o $(B)/src/base/product.o \
$(B)/src/device/cpu/densify_stats.%.o: CONTRACT := -ffp-contract=off

# Optimise the code in which tests under sanitisers spend most of their time.
ifeq ($(CONFIG),asan)
$(B)/src/device/cpu/%.o: HOT := -O1
$(B)/src/device/cpu/mlp.%.o $(B)/src/base/product.o: HOT := -O2
endif
define CPU_RULE
$(B)/%.$(1).o: %.c
	@mkdir -p $$(@D)
	$$(SAY) CC "$$< ($(1))"
	$$(Q)$$(COMPILE_C) -DSPIN_CPU_PATH=$(1) $$(FLAGS.$(1)) -MMD -MP -c -o $$@ $$<
endef
$(foreach p,$(PATHS),$(eval $(call CPU_RULE,$(p))))

$(B)/%.o: %.c
	@mkdir -p $(@D)
	$(SAY) CC $<
	$(Q)$(COMPILE_C) -MMD -MP -c -o $@ $<

# Where an installed library searches shims that are not in lib/ or lib/spin4d/ beside its program's
# bin/. Changing LIBDIR needs a new build; changing PREFIX, with LIBDIR below it, does not.
$(B)/src/device/device.o: SPIN_DEFINES := $(PATHS:%=-DSPIN_CPU_%)
$(B)/src/base/shim.o: SPIN_DEFINES := -DSPIN_LIBDIR='"$(LIBDIR)"'
$(B)/src/base/shim.o: $(B)/libdir
LIBDIR_IS := $(patsubst $(PREFIX)/lib,default,$(LIBDIR))
ifneq ($(shell cat $(B)/libdir 2>/dev/null),$(LIBDIR_IS))
.PHONY: $(B)/libdir
endif
$(B)/libdir:
	@mkdir -p $(@D) && echo $(LIBDIR_IS) >$@

# -O1 compiles tests in half the time of -O3; the library they call is compiled with -O3. UBSan is
# disabled in the rooms that compile no formulas of src/math: it would examine only the tests.
$(B)/tests/%.o: QUICK := $(if $(filter release,$(CONFIG)),-O1,$(if $(filter asan,$(CONFIG)),-fno-sanitize=undefined))
$(foreach r,device math model train,$(B)/tests/$r/%.o): QUICK := $(if $(filter release,$(CONFIG)),-O1)
$(B)/tests/bench/%.o: QUICK :=

# gold links the many tests in half the time of ld. Their first link looks for it.
TEST_LD = $(eval TEST_LD := $(shell $(CC) -fuse-ld=gold -Wl,--version 2>/dev/null | sed -n 's/^GNU gold.*/-fuse-ld=gold/p'))$(TEST_LD)
# The tests share one library that exports every symbol. After a change of the library they need not
# be linked again, so the prerequisite is order-only.
TEST_LIB := $(B)/tests/libspin-tests.so
$(TEST_LIB): $(LIB_O)
	@mkdir -p $(@D)
	$(SAY) LINK $@
	$(Q)$(LINK) $(TEST_LD) -shared -Wl,-soname,$(@F) -o $@ $(LIB_O) $(SPIN_LDLIBS) $(LDLIBS)
LINK_TEST = $(LINK) $(TEST_LD) -Wl,-rpath,'$$ORIGIN/..' -o $@ $(filter %.o,$^) $(TEST_LIB) $(SPIN_LDLIBS) $(LDLIBS)

# Objects that all tests link.
TEST_O := $(B)/tests/check.o $(B)/tests/device/strict.o
$(B)/tests/%: $(B)/tests/%.o $(TEST_O) | $(TEST_LIB) $(SHIMS)
	$(SAY) LINK $@
	$(Q)$(LINK_TEST)

# Fuzz targets: every build links them with a main() that replays inputs; `make fuzz F=npy` links
# libFuzzer (clang).
FUZZ_BIN := $(FUZZ_C:%.c=$(B)/%)
.PHONY: fuzz-bins
fuzz-bins: $(FUZZ_BIN)
$(B)/tests/fuzz/fuzz-%: $(B)/tests/fuzz/fuzz-%.o $(B)/tests/fuzz/replay.o | $(TEST_LIB)
	$(SAY) LINK $@
	$(Q)$(LINK_TEST)

T ?= 60
fuzz: ## one libFuzzer target: make fuzz F=npy [T=60], T in seconds
	@sh tests/fuzz/fuzz.sh "$(F)" "$(T)"

fuzz-replay: fuzz-bins ## replay all saved inputs without a fuzzer
	@K=fuzz sh tests/run.sh $(B) fuzz

check: ## test + lint under asan and ubsan: required before a commit
	@$(MAKE) --no-print-directory CONFIG=asan test
	@$(MAKE) --no-print-directory lint

mutants: ## draw faults from the sources; tests must detect them: [N=50] [SEED=1] [IN=src/train] [SINCE=rev] [MINUTES=9] [JOBS=n] [PART=1/9] [DRY=1] [LENIENT=1] [WIDE=1], or those of a list: M=word
	@command -v python3 >/dev/null || { echo "make mutants: python3 not found: apt-get install python3" >&2; exit $(if $(LENIENT),0,1); }; \
	N="$(N)" SEED="$(SEED)" IN="$(IN)" SINCE="$(SINCE)" PART="$(PART)" DRY="$(DRY)" MINUTES="$(or $(MINUTES),$(if $(SINCE),9))" LENIENT="$(LENIENT)" WIDE="$(WIDE)" JOBS=$(JOBS) python3 tests/mutants/run.py "$(M)"

changes: ## what the commands print and write that those of a revision do not: SINCE=HEAD~1 [K=words of tests] [SHOW=lines]
	@rev=$$(git rev-parse --short "$(or $(SINCE),HEAD~1)^{commit}") && old=$(BUILD)/changes/$$rev && mkdir -p $$old && \
	{ [ -e $$old/Makefile ] || git archive $$rev | tar -x -C $$old; } && \
	$(MAKE) -s -C $$old CONFIG=release CUDA=0 SETUP=0 CC="$(CC)" CXX="$(CXX)" all test-bins && \
	$(MAKE) -s CONFIG=release CUDA=0 SETUP=0 all test-bins && \
	SHOW="$(SHOW)" JOBS=$(JOBS) python3 tests/tools/changes.py $$old/build/release $(K)

tsan: ## the threaded tests under ThreadSanitizer
	@$(MAKE) --no-print-directory CONFIG=tsan test K=threads

valgrind: all ## run every command once under valgrind, to find leaks
	@sh tests/valgrind.sh $(B)/bin

test-viewers: ## exports in real viewers (Chromium, Node); SHORT=1  IMPORTERS=1  BUNDLE=own.spin
	@$(MAKE) --no-print-directory -j$(JOBS) all $(B)/tests/bench/clip
	@sh tests/viewers/run.sh $(B)/bin $(if $(SHORT),short)

bench-viewers: ## frame rate of the page and of SuperSplat's viewer (Chromium, Node); SPEED='--rounds 5'
	@$(MAKE) --no-print-directory -j$(JOBS) all
	@sh tests/viewers/run.sh $(B)/bin speed $(SPEED)

lint: ## includes, circles, headers, lists, manual, device pointers, plug-ins, language
	@printf '%s\n' tests/lint/*.sh | B=$(BUILD)/release xargs -P $(JOBS) -I LINT sh LINT "$(CC)" "$(CXX)"

$(BENCH): $(BENCH_O) $(LIB)
	$(SAY) LINK $@
	$(Q)$(LINK) -o $@ $(BENCH_O) $(LIB) $(SPIN_LDLIBS) $(LDLIBS)

bench: $(BENCH) ## time every stage of an iteration: make bench [A="--gaussians 50000 --table 21"]
	@$(BENCH) $(A)

results: all ## reproduce the rows of docs/results.md that use the bundled clip, in two minutes
	@RESULTS=all SPIN_BUILD=$(B) SPIN_BIN=$(B)/bin sh tests/cli/t9007-results.sh

pictures: all ## generate the images of docs/ and their figures (Chromium, Node): [COURT=folder of that clip]
	@sh src/packaging/pictures.sh $(B)/bin docs $(COURT)

hero: all ## generate docs/hero.webp, for README.md, from a retrained bundle: IN=better.spin [CAMERA=0] [BEFORE=B.spin OUT=W]
	@sh src/packaging/hero.sh $(B)/bin $(or $(IN),$(error IN=better.spin: the bundle is missing)) $(or $(OUT),docs/hero.webp) \
	    $(or $(CAMERA),00) $(BEFORE)

DEST    := $(DESTDIR)$(PREFIX)
DESTLIB := $(DESTDIR)$(LIBDIR)
EXAMPLE := share/doc/spin4d/example-plugin
# What the manual names, and a clip to try the commands on.
DOCS    := $(wildcard docs/*.md docs/*.jpg docs/*.png docs/*.webp docs/how-to/*)
SAMPLE  := $(filter-out %/gt_points.npz,$(shell find fixtures/court-mini -type f | sort))
SHARED  := $(notdir $(LIB_SO)) libspin.so.$(SOVERSION) libspin.so
BASH    := $(COMMANDS:%=share/bash-completion/completions/%)
ZSH     := $(COMMANDS:%=share/zsh/site-functions/_%)
COMPLETION = env -u SPIN_PLUGIN_PATH $(RUN) $(B)/bin/$$c --completion
PAGES   := $(sort $(wildcard man/*.[157]))
# The folder below PREFIX/lib in which PYTHON searches modules; if there is none, one without a
# version.
PYTHON    ?= $(firstword $(wildcard /usr/bin/python3) python3)
SITE      := import site, sys; lib = sys.argv[1] + "/lib/"; \
             print(*[d for d in site.getsitepackages() + [site.getusersitepackages()] if d.startswith(lib)][:1])
PYTHONDIR ?= $(or $(shell $(PYTHON) -c '$(SITE)' $(PREFIX) 2>/dev/null),$(PREFIX)/lib/python3/dist-packages)
install: all $(LIB) ## install into PREFIX, libraries into LIBDIR, all below DESTDIR
	install -d $(addprefix $(DEST)/,bin include/spin4d $(EXAMPLE)) $(addprefix $(DEST)/share/man/man,1 5 7)
	install -d $(DESTLIB)/spin4d $(DESTLIB)/pkgconfig
	install $(BINS) $(DEST)/bin
	install -m 644 $(SHIMS) $(DESTLIB)/spin4d
	install -m 644 $(LIB) $(LIB_SO) $(DESTLIB)
	for link in $(filter-out $(notdir $(LIB_SO)),$(SHARED)); do ln -sf $(notdir $(LIB_SO)) $(DESTLIB)/$$link; done
	install -m 644 src/spin.h src/spin_train.h src/spin_run.h $(DEST)/include/spin4d
	sed -e 's|@PREFIX@|$(PREFIX)|; s|@LIBDIR@|$(LIBDIR:$(PREFIX)/%=$${prefix}/%)|' -e 's|@VERSION@|$(VERSION)|' \
	    -e 's|@LIBS@|$(SPIN_LDLIBS)|' src/spin4d.pc.in >$(DESTLIB)/pkgconfig/spin4d.pc
	install -d $(DESTDIR)$(PYTHONDIR)
	install -m 644 exporters/python/spin4d.py $(DESTDIR)$(PYTHONDIR)
	install -d $(DEST)/share/spin4d/player $(DEST)/share/doc/spin4d/docs/how-to
	install -m 644 $(PLAYER) $(DEST)/share/spin4d/player
	install -m 644 $(filter-out docs/how-to/%,$(DOCS)) $(DEST)/share/doc/spin4d/docs
	install -m 644 $(filter docs/how-to/%,$(DOCS)) $(DEST)/share/doc/spin4d/docs/how-to
	for folder in $(sort $(patsubst %/,%,$(dir $(SAMPLE)))); do \
	    install -D -m 644 -t $(DEST)/share/spin4d/sample$${folder#fixtures/court-mini} \
	        $$(printf '%s\n' $(SAMPLE) | grep "^$$folder/[^/]*$$") || exit 1; \
	done
	$(foreach n,1 5 7,install -m 644 $(filter %.$n,$(PAGES)) $(DEST)/share/man/man$n &&) true
	install -m 644 man/example-plugin/Makefile man/example-plugin/*.c $(DEST)/$(EXAMPLE)
	install -d $(sort $(dir $(addprefix $(DEST)/,$(BASH) $(ZSH))))
	for c in $(COMMANDS); do \
	    $(COMPLETION) bash >$(DEST)/share/bash-completion/completions/$$c && \
	    $(COMPLETION) zsh >$(DEST)/share/zsh/site-functions/_$$c || exit 1; \
	done

uninstall: ## remove installed files, with the same PREFIX, LIBDIR, PYTHONDIR and DESTDIR
	rm -f $(addprefix $(DEST)/,$(COMMANDS:%=bin/%) $(BASH) $(ZSH)) $(addprefix $(DESTLIB)/,$(SHARED) libspin.a pkgconfig/spin4d.pc spin4d/spin-*.so)
	rm -f $(addprefix $(DEST)/,include/spin4d/spin.h include/spin4d/spin_train.h include/spin4d/spin_run.h) $(DESTDIR)$(PYTHONDIR)/spin4d.py
	rm -f $(foreach p,$(PAGES),$(DEST)/share/man/man$(subst .,,$(suffix $p))/$(notdir $p))
	rm -f $(addprefix $(DEST)/$(EXAMPLE)/,$(notdir $(wildcard man/example-plugin/*)))
	rm -f $(addprefix $(DEST)/share/spin4d/player/,$(notdir $(PLAYER)))
	rm -f $(addprefix $(DEST)/share/doc/spin4d/,$(DOCS)) $(SAMPLE:fixtures/court-mini/%=$(DEST)/share/spin4d/sample/%)
	-rmdir $(filter-out %/sample/,$(sort $(dir $(SAMPLE:fixtures/court-mini/%=$(DEST)/share/spin4d/sample/%))))
	-rmdir $(DEST)/share/spin4d/sample/ims $(DEST)/share/spin4d/sample $(DEST)/share/spin4d/player $(DEST)/share/spin4d
	-rmdir $(DEST)/share/doc/spin4d/docs/how-to $(DEST)/share/doc/spin4d/docs
	-rmdir $(DEST)/$(EXAMPLE) $(DEST)/share/doc/spin4d $(DEST)/include/spin4d $(DESTLIB)/spin4d

# DEBIAN= builds it in a chroot whose older C library makes it run on more machines.
portable: $(if $(DEBIAN),dist,$(BINS) $(BINS:$(B)/%=$(B)/portable/%) $(filter %-gltf.so %-cuda.so %-plain.so,$(SHIMS)) $(PLAYER)) ## BUILD/spin4d-VERSION-linux-*.tar.gz, self-contained; DEBIAN=bullseye (build it there) ARCH=arm64 (by QEMU)
	@$(if $(DEBIAN),sh src/packaging/chroot.sh $(DEBIAN) $(VERSION),sh src/packaging/portable.sh $(VERSION) $(B)) $(BUILD) $(if $(DEBIAN),$(ARCH))

windows: ## BUILD/windows/spin4d-VERSION-windows-x86_64.zip, built with MinGW
	@JOBS=$(JOBS) sh src/packaging/windows.sh $(VERSION) $(BUILD)

wheel: portable ## BUILD/spin4d-VERSION-*.whl for pip, from the output of `make portable`
	@$(PYTHON) src/packaging/wheel.py $(BUILD)/spin4d-$(VERSION)-linux-$(firstword $(subst -, ,$(MACHINE))).tar.gz $(BUILD)

dist: ## BUILD/spin4d-VERSION.tar.gz of the last commit, reproducible
	@mkdir -p $(BUILD)
	$(Q)git archive --prefix=spin4d-$(VERSION)/ HEAD | gzip -9n >$(BUILD)/spin4d-$(VERSION).tar.gz
	$(SAY) DIST $(BUILD)/spin4d-$(VERSION).tar.gz

deb: dist ## Debian packages of the last commit, in BUILD/deb; NOTEST=1 skips tests
	@NOTEST=$(NOTEST) sh src/packaging/deb.sh $(BUILD)

format: ## format all sources with clang-format
	clang-format -i $$(git ls-files '*.c' '*.h' '*.cpp' '*.cu')

clean: ## remove build outputs in BUILD, and bin
	rm -rf $(addprefix $(BUILD)/,release debug asan ubsan tsan cov race shims mutants fuzz web windows deb gcc clang arm64 bytes stderr test-needs changes debian-* *.tar.gz *.whl) bin
	-@rmdir $(BUILD) 2>/dev/null

-include $(shell find $(B) $(RACE) -name '*.d' 2>/dev/null)
endif
