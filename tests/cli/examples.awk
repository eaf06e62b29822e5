# Extracts the examples of a document or manual page into files NUMBER.sh and NUMBER.py in the
# folder `into`, and prints a line "NUMBER kind file:line" for each. A block that begins with "$ "
# is a session: only its lines after "$ " are run. A block that does not begin with a command is a
# drawing, a formula or a list of files and is skipped, but none of its lines may begin with one of
# our commands.
#
#     awk -v into=FOLDER -v first=1 -f tests/cli/examples.awk FILE...
BEGIN {
    # The first word of a command, after variable assignments.
    command = "^([A-Z_]+=[^ ]* )*(sudo |make|spin-|spin4d |mpirun |sh |node |npm |cc |cp |cd |git |python3 |curl |export |jq |chrt |apt|man |for |bench )"
    n = first - 1
}
function flush(    kind, i, text, out) {
    if (lines) {
        kind = line[1] ~ /^#!\/bin\/sh/ || line[1] ~ command ? "sh" : ""
        if (line[1] ~ /^[A-Z_]+=/ || (line[1] ~ /^#/ && line[2] ~ command))
            kind = "sh"
        if (line[1] ~ /^\$ /)
            kind = "session"
        if (line[1] ~ /^(import|from) / && line[1] !~ /from '/)
            kind = "py"
        text = ""
        for (i = 1; i <= lines; i++) {
            if (kind == "session") {
                if (line[i] !~ /^\$ /)
                    continue
                sub(/^\$ /, "", line[i])
            }
            if (!kind && line[i] ~ /^(spin-[a-z]+|spin4d) /)
                print "stray", start, line[i]
            text = text line[i] "\n"
        }
        if (kind) {
            out = into "/" ++n (kind == "py" ? ".py" : ".sh")
            printf "%s", text >out
            close(out)
            print n, kind == "py" ? "py" : "sh", start
        }
    }
    lines = 0
}
function add(text) {
    if (!lines)
        start = FILENAME ":" FNR
    line[++lines] = text
}
FNR == 1 { flush(); page = FILENAME ~ /\.[157]$/; fence = 0; code = 1 }
# Manual pages; consecutive .Dl lines are one example.
page && /^\.Bd -literal/ { flush(); literal = 1; next }
page && /^\.Ed/ { flush(); literal = 0; next }
page && literal { gsub(/\\e/, "\\"); add($0); next }
page && /^\.Dl / { gsub(/\\e/, "\\"); add(substr($0, 5)); next }
page { flush(); next }
# Markdown
/^```/ { flush(); fence = !fence; next }
fence { add($0); next }
/^    / && code { add(substr($0, 5)); next }
lines && /^$/ { add(""); next }
{ flush(); code = /^$/ || /^#/ }
END { flush() }
