"""rounding.py REPORT LOG [KEY...]: compares the errors in the line "rounds values" of a log with
those in the report of --check, which reads the output back."""
import json, re, sys

KEYS = "place log_scale rotation_deg opacity colour sh".split()
check = json.load(open(sys.argv[1]))["check"]
line = next(l for l in open(sys.argv[2]) if "rounds values" in l)
said = [float(x) for x in re.findall(r"[ (]([0-9][0-9.e+-]*)", line.partition("parentheses")[2])]
for key, pair in zip(KEYS, zip(said[::2], said[1::2])):
    if key in (sys.argv[3:] or KEYS):
        for name, value in zip(("rms", "largest"), pair):
            assert abs(value - check[key][name]) <= 0.051 * value, (key, name, value, check[key][name])
assert len(said) == 12, said
