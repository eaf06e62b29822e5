#!/bin/sh
# The language lint reports each kind of fault; the tools for rewriting comments detect changed
# code.
# K: lint language
. "$(dirname "$0")/lib.sh"

if ! command -v git >/dev/null || ! command -v python3 >/dev/null; then
    skip "language" "git or python3 not found"
    done_testing
fi
tree=$work/tree
mkdir -p "$tree/tests/lint" "$tree/tests/tools" "$tree/src/io" "$tree/man" "$tree/docs"
cp tests/lint/language.* "$tree/tests/lint"
cp tests/tools/prose.py tests/tools/draw.py tests/tools/same_objects.py "$tree/tests/tools"
cd "$tree" || exit 1
git() { command git -c user.name=t -c user.email=t@t -c init.defaultBranch=main "$@"; }

good_tree() {
    cat >src/io/file.c <<'END'
/* Reads an image. */
int read_card(const char *pictures) /* names are not prose */
{
    if (!pictures)
        return spin_fail(1, "cannot open '%s': no such image; " "see --pictures", pictures);
    return 7;
}
END
    printf '.Sh DESCRIPTION\nReads the images of a data set.\n.It Fl Fl pictures\n' >man/tool.1
    printf 'Read `pictures` with\n\n    tool --pictures\n' >docs/a.md
}
lint() { run sh tests/lint/language.sh; }

good_tree
lint
is "$code" 0 "a clean tree without history passes"
out_has 'no history' "which is said"
git init -q . && git add . && git commit -qm 'lint: add the rule'
lint
is "$code" 0 "a clean tree passes"

finds() { # FILE SED PATTERN NAME
    sed -i "$2" "$1"
    lint
    is "$code $(grep -c "^language: $3" "$work/out")" "1 1" "$4"
    good_tree
}
finds src/io/file.c '1s/an image/a picture/' "src/io/file.c:1: 'picture': write: image" "a word in a comment"
finds src/io/file.c '1s/an image/what a\n * camera sees/' "src/io/file.c:1: 'what a camera sees'" "a phrase on two lines"
finds src/io/file.c '5s/such image/pictures/' "src/io/file.c:5: 'pictures'" "a word in a message"
finds man/tool.1 's/the images/pictures/' "man/tool.1:2: 'pictures'" "a word in the manual"
finds docs/a.md '1s/with/pictures with/' "docs/a.md:1: 'pictures'" "a word in a document"
long=$(printf '%90s' ' ' | tr ' ' x)
finds src/io/file.c "1s/an/$long an/" "src/io/file.c:1: a comment reaches column" "a long comment"
finds src/io/file.c "4s|\$| // $long|" "src/io/file.c:4: a comment reaches column" "a long comment after code"

seventy_two=$(printf '%72s' ' ' | tr ' ' x)
git commit -q --allow-empty -m "$seventy_two"
lint
is "$code" 0 "a subject of 72 letters passes"
git commit -q --allow-empty -m "${seventy_two}x"
lint
is "$code" 1 "one of 73 fails"
out_has '^language: commit .* 73 letters' "and is named"
run python3 tests/lint/language.py HEAD
is "$code" 0 "but not when it came before the given commit"

same() { run python3 tests/tools/same_objects.py --quick "$@"; }
sed -i -e '1s/.*/\/* Reads\n * one image. *\//' -e 's/"see/"s" "ee/' -e 's/ return 7/\n        return 7/' src/io/file.c
sed -i '2s/.*/# Another comment/' tests/lint/language.sh
same
is "$code" 0 "comments, white space and how a string is cut may change"
sed -i 's/return 7/return 8/' src/io/file.c
same
is "$code" 1 "a number may not"
out_has "src/io/file.c:[0-9]*: was .* 7 .* is .* 8 " "the place is shown"
good_tree
git commit -qam 'lint: change a comment'
sed -i 's/exit 0/exit 1/' tests/lint/language.sh
same
is "$code" 1 "nor a line of a script"
same HEAD~1 HEAD
is "$code" 0 "two commits are compared"

run python3 tests/tools/draw.py --seed 3 comments 9 messages 9 manual 9
is "$code $(grep -c '^----' "$work/out")" "0 4" "all comments, messages and sentences can be drawn"
out_has 'io/file.c:5$' "a message with its place"
out_has ">> cannot open '%s': no such image; see --pictures" "and its text in one piece"
cp "$work/out" "$work/first"
run python3 tests/tools/draw.py --seed 3 comments 9 messages 9 manual 9
cmp -s "$work/out" "$work/first"
ok $? "a seed draws the same again"
done_testing
