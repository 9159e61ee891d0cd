# Photos of a layout of one's own, one of them damaged; scenes with truth, as a folder and an archive; two experiments.
depthcli sample --output made --count 8 --width 240 --height 180 --max-disparity 32 --quiet
mkdir photos experiments
number=0
for scene in made/*/; do
  number=$((number + 1))
  cp "$scene/left.png" "photos/field_0${number}_L.png"
  cp "$scene/right.png" "photos/field_0${number}_R.png"
done
head -c 400 photos/field_05_R.png > part
mv part photos/field_05_R.png
depthcli sample --output scenes --count 2 --width 240 --height 180 --max-disparity 32 --noise 2 --quiet
python -m zipfile -c scenes.zip scenes
echo 'base: fast' > experiments/fast.yaml
echo 'base: opencv-bm' > experiments/bm.yaml
