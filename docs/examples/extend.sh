# Scenes, a program and two networks.
depthcli sample --output scenes --count 4 --width 240 --height 180 --max-disparity 32 --quiet
examples="${PYTHONPATH#*:}"
cp "$examples/matcher.py" .
python "$examples/networks.py"
