"""Models that refer to other files or request too much, and part of the error for each."""

import os
import struct
from pathlib import Path

BODY = '<body><joint/><geom size="1"/></body>'
HINGE = '<body><joint name="j"/><geom size="1"/></body>'
NESTED_COPIES = '<replicate count="1000">' * 4 + BODY + "</replicate>" * 4
DEEP_BODIES = "<body>" * 10_000 + "</body>" * 10_000
FLEX = '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1"/>'
CONTACT = '<contact num="200000"/>'
LARGE = '<mesh file="large.obj"/>'
TABLE, HISTORY = '<numeric name="n" size="900000"/>', '<jointpos nsample="900000"/>'
BUILT_IN = '<mesh builtin="supertorus" params="250 0.5 1 1"/>'
TEXTURE = '<texture type="2d" builtin="flat" width="8192" height="8192"/>'
MODELS = {
    "include outside": ('<include file="../secret.xml"/>', "outside the folder of the problem"),
    "include absolute": ('<include file="/etc/passwd"/>', "outside the folder of the problem"),
    "include file:": ('<include file="file:///etc/passwd"/>', "outside the folder of the problem"),
    "include http:": ('<include file="http://localhost/m.xml"/>', "outside the folder of the problem"),
    "include itself": ('<include file="model.xml"/>', "twice, or in a circle"),
    "include in a circle": ('<include file="loop.xml"/>', "twice, or in a circle"),
    "a link out": ('<include file="link.xml"/>', "outside the folder of the problem"),
    "mesh outside": ('<asset><mesh file="../m.stl"/></asset>', "outside the folder of the problem"),
    "mesh folder outside": (
        '<compiler meshdir="/etc"/><asset><mesh file="m.stl"/></asset>',
        "outside the folder",
    ),
    "height field outside": ('<asset><hfield file="/etc/t.png"/></asset>', "outside the folder"),
    "plugin": ('<extension><plugin plugin="mujoco.sdf.bolt"/></extension>', "does not support plugins"),
    "plugin element": ("<worldbody><body><plugin/></body></worldbody>", "does not support plugins"),
    "nested copies": (f"<worldbody>{NESTED_COPIES}</worldbody>", "replicated elements"),
    "flexible body of many points": (f"<worldbody>{FLEX}</worldbody>", "points of flexible"),
    "infinite count": ('<worldbody><replicate count="inf"/></worldbody>', "the limit is 1000000"),
    "nested too deep": (f"<worldbody>{DEEP_BODIES}</worldbody>", "levels deep"),
    "huge texture": (
        '<asset><texture builtin="flat" width="900000" height="900000"/></asset>',
        "cells",
    ),
    "huge height field": ('<asset><hfield name="h" nrow="900000" ncol="900000"/></asset>', "cells"),
    "huge memory": ('<size memory="900T"/>', "reserves more"),
    "huge stack": ('<size nstack="9000000000000"/>', "reserves more"),
    "huge user data": ('<size nuserdata="2000000000"/>', "the limit is 1000000"),
    "two large sizes together": (f'<size nuserdata="900000"/><custom>{TABLE}</custom>', "numbers"),
    "user data of every geom": (
        f'<size nuser_geom="90000"/><worldbody>{20 * "<geom/>"}</worldbody>',
        "numbers",
    ),
    "large tables": (f"<custom>{2 * TABLE}</custom>", "numbers"),
    "huge contact sensor": ('<sensor><contact num="500000000"/></sensor>', "the limit is 1000000"),
    "many large sensors": (f"<sensor>{9 * CONTACT}</sensor>", "numbers"),
    "huge activation": ('<actuator><general actdim="500000000"/></actuator>', "the limit is 1000000"),
    "long histories": (f"<sensor>{2 * HISTORY}</sensor>", "numbers"),
    "huge camera": ('<worldbody><camera resolution="30000 30000"/></worldbody>', "cells"),
    "many textures": (f"<asset>{20 * TEXTURE}</asset>", "cells"),
    "huge built-in mesh": ('<asset><mesh builtin="plate" params="5000 5000"/></asset>', "cells"),
    "flexible body that compiles slowly": (
        '<worldbody><flexcomp count="30 30 30"/></worldbody>',
        "points of flexible",
    ),
    "flexible bodies of default size": (f"<worldbody>{6 * '<flexcomp/>'}</worldbody>", "points of flexible"),
    "flexible body of many cells": (
        '<worldbody><flexcomp count="2 2 2" cellcount="100 100 100"/></worldbody>',
        "points of flexible",
    ),
    "long chain": ('<worldbody><composite count="3000 1 1"/></worldbody>', "links"),
    "many copies": (f'<worldbody><replicate count="9000">{BODY}</replicate></worldbody>', "replicated"),
    "many built-in meshes": (f"<asset>{9 * BUILT_IN}</asset>", "cells"),
    "sides of a cube texture": ('<asset><texture builtin="flat" width="8192"/></asset>', "cells"),
    "texture size from a default": (
        f'<default><texture width="8192" height="8192"/></default><asset>{2 * "<texture/>"}</asset>',
        "cells",
    ),
    "huge off-screen buffer": ('<visual><global offwidth="90000" offheight="90000"/></visual>', "cells"),
    "huge shadow map": ('<visual><quality shadowsize="90000"/></visual>', "cells"),
    "activation size from a default": (
        f'<default><general actdim="9000"/></default><actuator>{200 * "<motor/>"}</actuator>',
        "numbers",
    ),
    "range finder with one value per pixel": (
        '<worldbody><camera name="c" resolution="2000 2000"/></worldbody>'
        '<sensor><rangefinder camera="c"/></sensor>',
        "numbers",
    ),
    "user values of every geom": (
        f'<worldbody><replicate count="2000"><geom user="{"1 " * 900}"/></replicate></worldbody>',
        "numbers",
    ),
    "too many keyframes": ('<size nkey="1000000"/>', "nkey"),
    "too many constraints": ('<size njmax="1000000"/>', "njmax"),
    "size attribute of a later MuJoCo": (
        '<worldbody><body numshadows="2000000000"/></worldbody>',
        "the limit is 1000000",
    ),
    "copies in an included file": (
        '<worldbody><replicate count="90"><include file="part.xml"/></replicate></worldbody>',
        "replicated",
    ),
    "sizes in an included file": (f'<include file="part.xml"/><sensor>{4 * CONTACT}</sensor>', "numbers"),
    "too many iterations": ('<option ls_iterations="1000000000"/>', "iterations"),
    "endless search for actuator lengths": (
        '<compiler><lengthrange inttotal="1e9"/></compiler>',
        "a lengthrange of more than",
    ),
    "time step that is not a number": ('<option timestep="nan"/>', "where a number is expected"),
    "negative time step": ('<option timestep="-0.01"/>', "it must be between"),
    "zero time step": ('<option timestep="0"/>', "it must be between"),
    "time step of a day": ('<option timestep="86400"/>', "timestep='86400'; it must be between .* and 1 s"),
    "tiny time step": ('<option timestep="1e-300"/>', "it must be between 1e-06 s"),
    "STL with 10^9 faces": ('<asset><mesh file="faces.stl"/></asset>', "its header declares"),
    "MSH with 10^9 points": ('<asset><mesh file="points.msh"/></asset>', "its header declares"),
    "mesh file that is a pipe": ('<asset><mesh file="pipe.stl"/></asset>', "not a regular file"),
    "image files with many pixels": (
        f'<asset>{2 * """<hfield file="wide.png"/>"""}</asset>',
        "images of 72000000 pixels",
    ),
    "large file referred to many times": (f"<asset>{5 * LARGE}</asset>", "files of 3145728.0 bytes"),
    "image file with 10^12 pixels": ('<asset><hfield file="pixels.png"/></asset>', "pixels"),
}
BOMB = '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><mujoco model="&b;"/>'
OUTSIDE = '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>'


def write_models(folder: Path) -> None:
    """Write the files that the models refer to."""
    (folder.parent / "secret.xml").write_text("<mujoco/>")
    folder.mkdir()
    (folder / "link.xml").symlink_to(folder.parent / "secret.xml")
    os.mkfifo(folder / "pipe.stl")
    (folder / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>')
    (folder / "part.xml").write_text(
        f'<mujoco><worldbody><replicate count="90">{BODY}</replicate></worldbody>'
        f"<sensor>{2 * CONTACT}</sensor></mujoco>"
    )
    (folder / "faces.stl").write_bytes(bytes(80) + struct.pack("<I", 10**9))
    (folder / "points.msh").write_bytes(struct.pack("<4i", 10**9, 0, 0, 0))
    for name, side in (("pixels", 10**6), ("wide", 6000)):
        image = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I", 13, b"IHDR", side, side)
        (folder / f"{name}.png").write_bytes(image)
    with open(folder / "large.obj", "wb") as file:
        file.truncate(60 << 20)
