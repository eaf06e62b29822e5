# shellcheck shell=sh
# Data on the fixtures that scripts of several rooms share: source it.

# The importers of runs, a name a line, as the command lists them.
importers_of_runs() { # BIN_DIR
    "$1/spin-import" --list --json | tr -d '\n' | sed 's/},/}\n/g' |
        sed -n 's/.*"name": "\([^"]*\)".*"tracks": true.*/\1/p'
}

run_of() { # IMPORTER: one of its runs, inside the large fixtures or those of the repository
    case $1 in
    4dgs) echo 4dgs/birth_sh2 ;;
    4dgaussian) echo 4dgaussian/coarse_and_fine/model ;;
    3dgstream) echo 3dgstream ;;
    d3dgs) echo d3dgs/cloud ;;
    dash) echo dash/default_like/model ;;
    deformable3dgs) echo deformable3dgs/real_small/model ;;
    ed3dgs) echo ed3dgs/annealed_early/model ;;
    gltf) echo splats/glb ;;
    ex4dgs) echo ex4dgs/small/model ;;
    gaussianflow) echo gaussianflow/dnerf_like ;;
    gifstream) echo gifstream/entropy_knn ;;
    grid4d) echo grid4d/dnerf_like/model ;;
    hybrid4dgs) echo hybrid4dgs/small/model ;;
    modecgs) echo modecgs/default_like/model ;;
    omg4) echo omg4/comp_xz ;;
    ply) echo ply/inria_sh3 ;;
    points) echo datasets/panoptic_mini/init_pt_cld.npz ;;
    realtime4dgs) echo realtime4dgs/rot4d_noshfs ;;
    freetimegs) echo freetimegs/still_sh0_no_optimizers ;;
    freetimegspp) echo freetimegspp/gated_sh3 ;;
    rotor4dgs) echo rotor4dgs/old_names ;;
    scgs) echo scgs/real_mask_hyper2/model ;;
    shapeofmotion) echo shapeofmotion/fg_only_k4 ;;
    spacetimegs) echo spacetimegs/full_techni/model ;;
    ksplat) echo splats/ksplat ;;
    sog) echo splats/sog ;;
    splat) echo splats/splat ;;
    splat4d) echo splat4d/default_bounds ;;
    spz) echo splats/spz4 ;;
    sogst) echo sogst/no_segments ;;
    stglite) echo stglite/supersplat4d_sh1/scene.ply ;;
    usd) echo usd/clip/scene.usda ;;
    tsog) echo tsog/continuous_nomotion_audio ;;
    tc3dgs) echo tc3dgs/trained ;;
    esac
}

# Cameras on a circle of this radius that face the centre, each at three times, in the layout of
# n3v2blender.py; the first is held out. The images are to be images/cam<0C>_000<T>, with C up to 5
# and T up to 2.
cameras() { # FOLDER RADIUS LAST_TIME
    for split in train test; do
        awk -v radius="$2" -v last="$3" -v test="$([ $split = test ]; echo $?)" 'BEGIN {
            print "{\"w\": 160, \"h\": 90, \"fl_x\": 150, \"fl_y\": 150, \"cx\": 80, \"cy\": 45, \"frames\": ["
            first = test == 0 ? 0 : 1
            for (camera = first; camera < (test == 0 ? 1 : 6); camera++) {
                s = sin(1.05 * camera); c = cos(1.05 * camera)
                for (t = 0; t < 3; t++) {
                    printf "%s{\"file_path\": \"images/cam%02d_%04d\", \"time\": %g,\n", \
                        comma++ ? "," : "", camera, t, last * t / 2
                    printf " \"transform_matrix\": [[%.9g, 0, %.9g, %.9g], [0, 1, 0, 0],", c, s, radius * s
                    printf " [%.9g, 0, %.9g, %.9g], [0, 0, 0, 1]]}\n", -s, c, radius * c
                }
            }
            print "]}" }' >"$1/transforms_$split.json"
    done
}

# An image of 160 x 90 for all of these views.
stand_in() { # FOLDER PICTURE
    mkdir -p "$1/images"
    for camera in 0 1 2 3 4 5; do
        for frame in 0 1 2; do
            cp "$2" "$1/images/cam0${camera}_000$frame.jpg"
        done
    done
}
