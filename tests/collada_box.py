"""Text of a Collada file: a box at a node, by polygons."""

# A box of 0.4 x 0.1 x 0.06, of polygons with four corners, with one corner at the origin.
CORNERS = "0 0 0  .4 0 0  .4 .1 0  0 .1 0  0 0 .06  .4 0 .06  .4 .1 .06  0 .1 .06"
SIDES = "0 3 2 1  4 5 6 7  0 1 5 4  1 2 6 5  2 3 7 6  3 0 4 7"
DAE = f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><created>2020-01-01</created><modified>2020-01-01</modified><unit name="metre" meter="1"/>
    <up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="box"><mesh>
    <source id="p"><float_array id="a" count="24">{CORNERS}</float_array><technique_common>
      <accessor source="#a" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
        <param name="Z" type="float"/></accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/>
      <vcount>4 4 4 4 4 4</vcount><p>{SIDES}</p></polylist>
  </mesh></geometry></library_geometries>
  <library_nodes></library_nodes>
  <library_visual_scenes><visual_scene id="s"><node id="n"><translate>0 0 1</translate>
    <instance_geometry url="#box"/></node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""
