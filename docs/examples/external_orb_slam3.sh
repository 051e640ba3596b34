#!/bin/sh
# ORB-SLAM3 as an external method, for whoever has it built. The same script serves any system that reads TUM RGB-D
# folders: change the last lines.
#
#   ORB_SLAM3=/path/to/ORB_SLAM3 slam-init compare FOLDER --method \
#     'orb-slam3-real=command:sh external_orb_slam3.sh {images} {times} {camera} {out}'
#
# ORB-SLAM3 writes the keyframes of the whole run. The first two are its initial pair; they are the map that is judged.
set -eu
images=$1 times=$2 camera=$3 out=$4
: "${ORB_SLAM3:?set ORB_SLAM3 to the folder of a build of ORB-SLAM3}"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# The folder of TUM RGB-D: rgb.txt with three lines of comment, which its reader skips.
ln -s "$images" "$work/rgb"
{ printf '# frames\n# by slam-init\n# timestamp filename\n'; sed 's/ / rgb\//' "$times"; } > "$work/rgb.txt"

# Its calibration. Coefficients that the camera lacks are 0.
value() { sed -n "s/^$1: *//p" "$camera"; }
coefficient() { value distortion | tr -d '[] ' | cut -d, -f"$1" | grep . || echo 0.0; }
decimal() { awk -v v="$1" 'BEGIN { printf "%.10f", v }'; }  # its parser needs a decimal point
{
  printf '%%YAML:1.0\n---\nFile.version: "1.0"\nCamera.type: "PinHole"\n'
  for name in fx fy cx cy; do printf 'Camera1.%s: %s\n' "$name" "$(decimal "$(value $name)")"; done
  position=1
  for name in k1 k2 p1 p2 k3; do
    printf 'Camera1.%s: %s\n' "$name" "$(decimal "$(coefficient $position)")"
    position=$((position + 1))
  done
  printf 'Camera.width: %s\nCamera.height: %s\nCamera.fps: 30\nCamera.RGB: 0\n' "$(value width)" "$(value height)"
  printf 'ORBextractor.nFeatures: 1000\nORBextractor.scaleFactor: 1.2\nORBextractor.nLevels: 8\n'
  printf 'ORBextractor.iniThFAST: 20\nORBextractor.minThFAST: 7\n'
  printf 'Viewer.KeyFrameSize: 0.05\nViewer.KeyFrameLineWidth: 1.0\nViewer.GraphLineWidth: 0.9\n'
  printf 'Viewer.PointSize: 2.0\nViewer.CameraSize: 0.08\nViewer.CameraLineWidth: 3.0\n'
  printf 'Viewer.ViewpointX: 0.0\nViewer.ViewpointY: -0.7\nViewer.ViewpointZ: -1.8\nViewer.ViewpointF: 500.0\n'
} > "$work/camera.yaml"

cd "$work"
"$ORB_SLAM3/Examples/Monocular/mono_tum" "$ORB_SLAM3/Vocabulary/ORBvoc.txt" "$work/camera.yaml" "$work"
[ -s KeyFrameTrajectory.txt ] || exit 0  # no map
head -n 2 KeyFrameTrajectory.txt > "$out/trajectory.txt"
# It initializes at its second keyframe.
second=$(sed -n '2s/ .*//p' KeyFrameTrajectory.txt)
awk -v t="$second" '$1 <= t + 1e-4 { n++ } END { print n }' "$times" > "$out/frames_read.txt"
