#!/bin/sh
# The manual page and --help all have the same options. For spin-retrain, importers and exporters
# they also agree on arguments and defaults. man/spin4d.7 lists every environment variable. If
# mandoc is installed, it finds no fault in the pages, and no line is longer than 80 columns. SEE
# ALSO refers to spin4d(7), which lists all pages.
# B: the build folder (build/release).
bin=${B:-build/release}/bin
failed=0
checked=0

# Lines "--name argument (default)": from a --help text, or from a page, where "Default: " begins a
# line.
lines_of_help() {
    awk 'function flush() {
            fallback = match(help, /\([^()]*\)$/) ? substr(help, RSTART) : ""
            sub(/^\(default: /, "(", fallback)
            if (name) print "--" name, arg, fallback
            name = ""
        }
        /^  (-., |    )--/ {
            flush()
            sub(/^ *(-., )?--/, "")
            help = match($0, /   *[^ ]/) ? substr($0, RSTART + RLENGTH - 1) : ""
            left = RSTART ? substr($0, 1, RSTART - 1) : $0
            name = arg = left
            sub(/ .*/, "", name)
            sub(/^[^ ]* ?/, "", arg)
            next
        }
        /^ / { sub(/^ */, ""); help = help (help ? " " : "") $0; next }
        { flush() }
        END { flush() }'
}
lines_of_page() {
    awk 'function flush() {
            if (name) print "--" name, arg, fallback
            name = ""
        }
        /^\.(It|El|Ss|Sh)/ { flush() }
        /^\.It .*Fl Fl / {
            sub(/.*Fl Fl /, "")
            name = $1
            fallback = ""
            sub(/^[^ ]*( Ar )?/, "")
            gsub(/ \| /, "|")
            arg = $0
        }
        /^Default: .*\.$/ { fallback = "(" substr($0, 10, length($0) - 10) ")" }'
}

# The options of one part of a page: "" is the whole page, otherwise its .Ss.
part_of_page() { awk -v part="$2" '/^\.S[hs]/ { on = $0 == ".Ss " part } on' "$1"; }

complain() {
    echo "manual: $*"
    failed=1
}

# compare_plugins COMMAND SELECTOR PAGE SHARED...: the help of each plug-in and its part of the page
# have the same options; some of them may be in a part that several plug-ins share.
compare_plugins() {
    name=$1
    selector=$2
    of=$3
    shift 3
    lines_of_shared=$(for part in "$@"; do part_of_page "$of" "$part" | lines_of_page; done)
    all_help=
    for plugin in $("$bin/$name" --list | awk '/^[a-z0-9]/ { print $1 }'); do
        grep -qx "\.Ss $plugin" "$of" || complain "$of has no part '$plugin'"
        help=$("$bin/$name" "$selector" "$plugin" --help | sed -n '/^Options of/,$p' | lines_of_help |
            sed 's/(frame_%05d\.[a-z.]*)/(frame_%05d.ENDING)/')
        own=$(part_of_page "$of" "$plugin" | lines_of_page)
        all_help="$all_help
$help"
        lacks=$(printf '%s\n' "$help" | grep -vxF -e "$own" -e "$lines_of_shared")
        [ -z "$lacks" ] || complain "$of lacks of $plugin, or has with another argument or default: $lacks"
        more=$(printf '%s\n' "$own" | grep -vxF -e "$help")
        [ -z "$more" ] || complain "$of has of $plugin, and its --help has not: $more"
        checked=$((checked + $(printf '%s' "$help" | grep -c .)))
    done
    more=$(printf '%s\n' "$lines_of_shared" | grep -vxF -e "$all_help")
    [ -z "$more" ] || complain "$of has among what exporters share, and no --help has: $more"
}

for page in man/*.[157]; do
    name=$(basename "$page")
    name=${name%.*}
    if command -v mandoc >/dev/null 2>&1; then
        # Pages that are not installed are taken from man/.
        faults=$(mandoc -T lint -W warning "$page" | grep -v 'referenced manual not found')
        [ -z "$faults" ] || complain "$faults"
        wide=$(mandoc -T ascii "$page" | col -bx | awk 'length > 80')
        [ -z "$wide" ] || complain "$page has lines above 80 columns: $wide"
    fi
    others=man/spin4d.7
    [ "$page" = man/spin4d.7 ] && others=$(ls man/*.[157])
    for other in $others; do
        other=$(basename "$other")
        [ "$other" = "$(basename "$page")" ] ||
            sed -n '/^\.Sh SEE ALSO/,$p' "$page" | grep -q "^\.Xr ${other%.*} ${other##*.}" ||
            complain "SEE ALSO of $page lacks ${other%.*}(${other##*.})"
    done
    for reference in $(sed -n 's/.*\.Xr \([^ ]*\) \([0-9]\).*/\1.\2/p' "$page"); do
        [ -f "man/$reference" ] || complain "$page names $reference, which is not there"
    done
done
for variable in $(grep -rhoE '"(SPIN|OMPI|PMI|PMIX|SLURM)_[A-Z_]+"' src importers exporters --include='*.c' --include='*.cu' |
    grep -v -e _SYMBOL -e _ABI | tr -d '"' | sort -u); do
    grep -qE "^\.(It )?Ev (.* )?$variable( |\$)" man/spin4d.7 || complain "man/spin4d.7 lacks the variable $variable"
done

for page in man/spin*.1; do
    name=$(basename "$page" .1)
    if [ ! -x "$bin/$name" ]; then
        echo "manual: $name is not built in $bin, its options are not compared"
        continue
    fi
    help=$("$bin/$name" --help all | sed -n 's/^  \(-., \|    \)--\([a-z0-9-]*\).*/\2/p' | sort)
    manual=$(sed -n 's/^\.It .*Fl Fl \([a-z0-9-]*\).*/\1/p' "$page" | sort)
    checked=$((checked + $(echo "$help" | grep -c .)))
    for option in $(echo "$help" | grep -vxF -e "$manual"); do
        complain "$page lacks --$option"
    done
    for option in $(echo "$manual" | grep -vxF -e "$help"); do
        complain "$page has --$option, which $name --help lacks"
    done
    case $name in
    spin-retrain)
        differences=$({
            "$bin/$name" --help all | lines_of_help
            lines_of_page <"$page"
        } | sort | uniq -u)
        [ -z "$differences" ] || complain "$page and --help differ: $differences"
        ;;
    spin-import)
        compare_plugins spin-import --from man/spin-importers.7 "Options of several runs" "4danyone and easyvolcap" \
            "Numbered files" "Options of rigs"
        ;;
    spin-export)
        compare_plugins spin-export --to man/spin-exporters.7 "All formats of splats" "Images and video"
        ;;
    esac
    for option in $("$bin/$name" --help all | sed -n 's/^  -\(.\), --.*/\1/p'); do
        grep -q "^\.It Fl $option ," "$page" || complain "$page lacks -$option"
    done
done
[ $failed = 0 ] && echo "manual: $checked options in help and manual agree"
exit $failed
