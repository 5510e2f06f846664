#!/usr/bin/env bash
# Two workspaces with a package of the same name: xacrodoc expands the second file with the first one's macros
#
# Guess: XacroDoc.from_file looks for $(find parts) from the file's own folder upwards, so that each file is expanded
# with the package parts in its own workspace.
# Seen: xacrodoc 2.0.1 keeps the folders of packages for the rest of the process; without a message, the second arm has
# the length of the first one. After packages.reset() it has its own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check xacrodoc==2.0.1 xacro==2.1.1 rospkg==1.6.3
for workspace in a b; do
  mkdir -p $workspace/parts
  echo '<package><name>parts</name></package>' > $workspace/parts/package.xml
  cat > $workspace/parts/arm.xacro <<'XML'
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find parts)/length.xacro"/><link name="length_${length}"/></robot>
XML
done
for pair in a:0.3 b:0.5; do
  cat > ${pair%:*}/parts/length.xacro <<XML
<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="length" value="${pair#*:}"/></robot>
XML
done
venv/bin/python - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import re

from xacrodoc import XacroDoc, packages


def length(file):
    return re.search("length_([0-9.]+)", XacroDoc.from_file(file).to_urdf_string())[1]


print("a:", length("a/parts/arm.xacro"))
print("b after a:", length("b/parts/arm.xacro"))
packages.reset()
print("b after packages.reset():", length("b/parts/arm.xacro"))
PY
diff seen.txt - <<'EXPECTED' || exit 1
a: 0.3
b after a: 0.3
b after packages.reset(): 0.5
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
