"""Robot programs of others: what is read of them, and what is refused with its line."""

import numpy as np
import pytest
from motion_files import GROUPS, controller, hinged, railed, read_text, refusal
from scipy.spatial.transform import Rotation

NOT = "9E+09,9E+09,9E+09,9E+09,9E+09,9E+09"
HOME = f"[[0,0,0,0,90,0],[{NOT}]]"

# --- RAPID

MODULE = f"""%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE Weld(SYSMODULE)
  ! MoveL p1,v5,fine,tool0;
  CONST robjoint bent:=[10,-20.5,+30,4e1,0.5,-6];
  CONST jointtarget home := {HOME};
  LOCAL PERS jointtarget over:=[bent,[{NOT}]];
  CONST zonedata zone:=[FALSE,7.5,8,8,1,8,1];
  PERS tooldata torch:=[TRUE,[[0,0,200],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];
  PROC main()
    AccSet 50,50;
    Seam;
  ENDPROC
  PROC Seam()
    ConfJ\\Off;
    TPWrite "IF this; MoveL";
    MoveAbsJ home\\NoEOffs,v1000,fine,torch\\WObj:=wobj0;
    moveabsj over \\NoEOffs,
      v100 \\T:=2.5, z50 \\Z:=45, torch;
    SetDO doArc,1;
    MoveAbsJ [[1,2,3,4,5,6],[{NOT}]],[100,500,5000,1000]\\T:=0.5,zone,torch;
    MoveAbsJ \\Conc,home,v100\\T:=1,z10,torch;
    MoveAbsJ [bent,[{NOT}]],v100\\T:=1,fine,torch;
  ERROR
    RETRY;
  ENDPROC
ENDMODULE
"""


def test_a_rapid_module_is_read_with_constants_switches_zones_times_and_a_called_procedure(tmp_path):
    found = read_text(tmp_path, "seam.mod", MODULE)
    bent = [10, -20.5, 30, 40, 0.5, -6]
    expected = [[0, 0, 0, 0, 90, 0], bent, [1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 90, 0], bent]
    assert np.abs(np.degrees(found.x) - expected).max() < 1e-12
    assert found.corner_m.tolist() == [0, 0.045, 0.0075, 0.01, 0]
    assert found.time_s.tolist() == [0, 2.5, 3, 4, 5]
    assert found.line.tolist() == [19, 20, 23, 24, 25]
    assert any("AccSet, ConfJ\\Off, SetDO, TPWrite" in note for note in found.notes)
    assert any("Persistent" in note and "over" in note for note in found.notes)


def in_main(*lines: str, data: str = "") -> str:
    body = "\n".join(("MoveAbsJ home,v100,z10,tool0;", *lines))
    return f"MODULE M\nCONST jointtarget home:={HOME};{data}\nPROC main()\n{body}\nENDPROC\nENDMODULE\n"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("MoveL p1,v5,fine,tool0;", "line 5: MoveL moves in a way that cannot be read; only MoveAbsJ is"),
        ("MoveJ p1,v5,fine,tool0;", "line 5: MoveJ moves in a way that cannot be read; only MoveAbsJ is"),
        ("MoveC p1,p2,v5,fine,tool0;", "line 5: MoveC moves in a way that cannot be read; only MoveAbsJ is"),
        ("ArcLStart p1,v5,s,fine,tool0;", "line 5: ArcLStart moves in a way"),
        ("TriggJ p1,v5,t,fine,tool0;", "line 5: TriggJ moves in a way"),
        ("EOffsSet e;", "line 5: EOffsSet moves in a way"),
        ("IF a=1 THEN\nENDIF", "line 5: IF controls the flow"),
        ("IF a=1 MoveAbsJ home,v100,fine,tool0;", "line 5: IF controls the flow"),
        ("FOR i FROM 1 TO 3 DO\nENDFOR", "line 5: FOR controls the flow"),
        ("WHILE TRUE DO\nENDWHILE", "line 5: WHILE controls the flow"),
        ("TEST a\nCASE 1:\nENDTEST", "line 5: TEST controls the flow"),
        ("GOTO again;", "line 5: GOTO controls the flow"),
        ("RETURN;\nSetDO d,1;", "line 5: RETURN before the end controls the flow"),
        ("GripperOpen;", "line 5: GripperOpen; is not known".replace(";", "")),
        ('%"Other"%;', "line 5: %"),
        ("MoveAbsJ p9,v5,fine,tool0;", "line 5: the joint target p9 cannot be read"),
        ("MoveAbsJ *,v5,fine,tool0;", "line 5: the joint target * cannot be read"),
        ("MoveAbsJ CalcJointT(p1,tool0),v5,fine,tool0;", "line 5: the joint target CalcJointT"),
        (f"MoveAbsJ [[1,2,3,4,5],[{NOT}]],v5,fine,tool0;", "line 5: the joint target"),
        ("MoveAbsJ home,v5,z7,tool0;", "line 5: the zone z7 cannot be read; valid: fine, z0, z1"),
        ("MoveAbsJ home,v5\\T:=x,z5,tool0;", "line 5: \\T:=x cannot be read"),
        ("MoveAbsJ home,v5,z5\\Z:=1e999,tool0;", "line 5: \\Z:=1e999 cannot be read"),
        ("MoveAbsJ home,v5;", "line 5: MoveAbsJ with 2 arguments; valid: "),
        ("MoveAbsJ [[0,0,0,0,0,0],[5,9E9,9E9,9E9,9E9,9E9]],v5,z5,tool0;", "line 5: 1 external axes are connected"),
        ("home.robax.rax_1:=7;\nMoveAbsJ home,v5,fine,tool0;", "line 6: the joint target home cannot be read"),
        ('TPWrite "not closed;', "line 5: a text is not closed"),
        ("main;", "line 5: main calls itself"),
    ],
)
def test_what_cannot_be_read_of_rapid_is_refused_with_its_line(line, message, tmp_path):
    assert refusal(tmp_path, "a.mod", in_main(line)).startswith(f"a.mod, {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("PROC b()\nMoveAbsJ home,v5,fine,tool0;\nENDPROC", "line 7: a move in b, which main does not call"),
        ("PROC b()\nIF x MoveL p,v5,fine,tool0;\nENDPROC", "line 7: a move in b, which main does not call"),
        ("TRAP b\nMoveAbsJ home,v5,fine,tool0;\nENDTRAP", "line 7: a move in a TRAP"),
        ("FUNC num b()\nMoveAbsJ home,v5,fine,tool0;\nENDFUNC", "line 7: a move in a FUNC"),
        ("PROC b()\nERROR\nMoveL p,v5,fine,tool0;\nENDPROC", "line 8: a move in an error handler"),
    ],
)
def test_a_move_outside_of_what_runs_is_refused(text, message, tmp_path):
    assert refusal(tmp_path, "a.mod", in_main().replace("ENDMODULE", f"{text}\nENDMODULE")).startswith(
        f"a.mod, {message}"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("MODULE M\nPROC a()\nENDMODULE\n", "line 3: the end of a is missing"),
        ("MODULE M\nPROC a()\nENDPROC\nENDPROC\nENDMODULE\n", "line 4: ENDPROC ends nothing"),
        ("MODULE M\nPROC a()\nENDPROC\n", "line 4: the end of the module is missing"),
        ("PROC a()\nPROC b()\nENDPROC\n", "line 2: the end of a is missing"),
    ],
)
def test_a_module_that_is_cut_is_refused(text, message, tmp_path):
    assert refusal(tmp_path, "a.mod", text) == f"a.mod, {message}"


def test_the_main_module_of_a_split_program_names_the_procedures_that_it_lacks(tmp_path):
    message = refusal(tmp_path, "a.mod", "MODULE M\nPROC weld()\nweld_1;\nweld_2;\nENDPROC\nENDMODULE\n")
    assert message.endswith("contains no MoveAbsJ in a procedure; it calls weld_1, weld_2, which it does not contain")


def test_two_procedures_that_move_need_a_main(tmp_path):
    text = "MODULE M\n" + "".join(
        f"PROC {name}()\nMoveAbsJ {HOME},v5,fine,tool0;\nENDPROC\n" for name in ("first", "second")
    )
    message = refusal(tmp_path, "a.mod", f"{text}ENDMODULE\n")
    assert message.startswith("a.mod, line 6: several procedures move: first, second; valid: one, or a main")
    called = read_text(tmp_path, "b.mod", f"{text}PROC main()\nsecond;\nfirst;\nsecond;\nENDPROC\nENDMODULE\n")
    assert called.line.tolist() == [6, 3, 6]


def test_a_variable_has_the_value_of_its_last_assignment(tmp_path):
    found = read_text(
        tmp_path,
        "a.mod",
        in_main(f"next:=[[1,2,3,4,5,6],[{NOT}]];", "MoveAbsJ next,v5,fine,tool0;", data="VAR jointtarget next;"),
    )
    assert np.abs(np.degrees(found.x[1]) - range(1, 7)).max() < 1e-12


def test_external_axes_are_those_of_the_groups(tmp_path):
    text = in_main().replace(NOT, "1500,-90,9E9,9E9,9E9,9E9")
    found = read_text(tmp_path, "a.mod", text, railed())
    assert np.allclose(found.x, [[1.5, 0, 0, 0, 0, np.pi / 2, 0, -np.pi / 2]], atol=1e-15)
    message = refusal(tmp_path, "b.mod", text, railed(), controller(railed(), groups=None))
    assert message.startswith("b.mod: a robot of 8 joints; robjoint has 6; set program.groups")
    assert "the job's groups have rail, turn" in refusal(tmp_path, "c.mod", in_main(), railed())


# --- URScript

SCRIPT = """# a comment: movel(p[0,0,0,0,0,0])
def weld():
  set_tcp(p[0,0,0.2,0,0,0])
  set_standard_digital_out(0, True)
  textmsg("movel(#")
  global home = [0, -1.57, 1.57, 0, 1.57, 0]
  bend = 0.5/2 + 1*0
  movej(home, a=1.4, v=1.05)
  movej([d2r(90), bend, -.5, 1e-1, 0,
         0], 1.4, 1.05, 0, 0.05)
  sleep(0.5)
  movej(home, t=3, r=0.02)
  home = [1,2,3,4,5,6]
  movej(q=home)
  stopj(2.0)
end
"""


@pytest.mark.parametrize("call", ["", "weld()\n"])
def test_a_script_is_read_with_variables_degrees_and_blends(call, tmp_path):
    found = read_text(tmp_path, "weld.script", SCRIPT + call)
    home = [0, -1.57, 1.57, 0, 1.57, 0]
    assert np.allclose(found.x, [home, [np.pi / 2, 0.25, -0.5, 0.1, 0, 0], home, [1, 2, 3, 4, 5, 6]], atol=1e-15)
    assert (found.corner_m.tolist(), found.time_s, found.line.tolist()) == ([0, 0.05, 0.02, 0], None, [8, 9, 12, 14])
    assert any("set_standard_digital_out, set_tcp, sleep, stopj, textmsg" in note for note in found.notes)


def test_a_script_without_a_function_is_read_with_its_times(tmp_path):
    servo = "servoj([0,0,0,0,0,0.1], t=0.008, lookahead_time=0.1, gain=300)\nservoj([0,0,0,0,0,0.2])\n"
    found = read_text(tmp_path, "a.script", f"movej([0,0,0,0,0,0])\n{servo}")
    assert found.time_s.tolist() == [0, 0.008, 0.01]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("movel(p[0,0,0,0,0,0])", "line 2: movel moves in a way that cannot be read; only movej and servoj are"),
        ("movep(p[0,0,0,0,0,0])", "line 2: movep moves in a way"),
        ("movec(p[0,0,0,0,0,0], p[0,0,0,0,0,1])", "line 2: movec moves in a way"),
        ("speedj([0,0,0,0,0,1], 1, 1)", "line 2: speedj moves in a way"),
        ("while True:\n  sleep(1)\nend", "line 2: while controls the flow"),
        ("if x > 1:\n  sleep(1)\nend", "line 2: if controls the flow"),
        ("thread t():\n  sleep(1)\nend", "line 2: thread controls the flow"),
        ("gripper_open()", "line 2: gripper_open is not known, it may move"),
        ("x = movel(p[0,0,0,0,0,0])", "line 2: movel in an assignment"),
        ("movej(p[0,0,0,0,0,0])", "line 2: movej to p[0,0,0,0,0,0] cannot be read"),
        ("movej(get_inverse_kin(p[0,0,0,0,0,0]))", "line 2: movej to get_inverse_kin"),
        ("movej(somewhere)", "line 2: movej to somewhere cannot be read"),
        ("movej([0,1/2,0,0,0,0])", "line 2: movej to [0,1/2,0,0,0,0] cannot be read"),
        ("a = 1\nmovej([0,a/2,0,0,0,0])", "line 3: movej to [0,a/2,0,0,0,0] cannot be read"),
        ("movej([0,0,0,0,0,0], r=1e999)", "line 2: r=1e999 cannot be read"),
        ("movej([0,0,0,0,0,nan])", "line 2: movej to [0,0,0,0,0,nan] cannot be read"),
        ("movej([0,0,0,0,0])", "line 2: 5 values; gp50 has 6 joints: joint1"),
        ("movej([0,0,0,0,0,0], speed=1)", "line 2: movej has an argument 'speed=1'"),
        ("movej([0,0,0,0,0,0], r=far)", "line 2: r=far cannot be read"),
        ("movej([0,0,0,0,0,0]", "line 2: a bracket is not closed"),
        ("move to home", "line 2: 'move to home' cannot be read"),
        ("end", "line 2: end without a function"),
    ],
)
def test_what_cannot_be_read_of_a_script_is_refused_with_its_line(line, message, tmp_path):
    assert refusal(tmp_path, "a.script", f"movej([0,0,0,0,0,0])\n{line}\n").startswith(f"a.script, {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def p():\nmovej([0,0,0,0,0,0])\nend\np()\np()\n", "line 5: a second call of p"),
        ("def p():\nmovej([0,0,0,0,0,0])\nend\nmovej([0,0,0,0,0,0])\n", "line 2: the function p is not called"),
        ("def p(a):\nmovej(a)\nend\np([0,0,0,0,0,0])\n", "line 1: 'def p(a):' cannot be read"),
        ("def p():\nmovej([0,0,0,0,0,0])\n", "line 2: the end of the function p is missing"),
        ("def o():\nend\n", ""),
    ],
)
def test_functions_of_a_script_run_once(text, message, tmp_path):
    assert refusal(tmp_path, "a.script", text).startswith(f"a.script, {message}" if message else "a.script contains no")


def test_sums_of_joints_are_refused_where_no_controller_has_them(tmp_path):
    own = controller(hinged(), coupled=((2, 1),))
    for name, text in (("a.script", SCRIPT), ("a.jbi", job(["C00000=0,0,0,0,0,0"], ["MOVJ C00000 VJ=1.00"]))):
        assert "does not support program.coupled" in refusal(tmp_path, name, text, given=own)


# --- INFORM


def job(positions, instructions, kind=("///POSTYPE PULSE", "///PULSE"), counts=None) -> str:
    numbers = counts or [sum(line.startswith(f"{name}0") for line in positions) for name in ("C", "BC", "EC")] + [0] * 3
    head = ["/JOB", "//NAME A", "//POS", f"///NPOS {','.join(map(str, numbers))}", "///USER 1", "///TOOL 2", *kind]
    return "\r\n".join(
        [*head, *positions, "//INST", "///DATE 2020/01/01 00:00", "///GROUP1 RB1", "NOP", *instructions, "END", ""]
    )


def test_a_job_of_pulses_is_read_in_the_order_of_its_instructions(tmp_path):
    text = job(
        ["C000=0,0,0,0,0,0", "C001=85000,-73000,0,0,0,0 "],
        [
            "'MOVL in a remark",
            "SPEED VJ=5.00",
            "MOVJ C001 VJ=5.00 PL=0",
            "DOUT OT#(1) ON",
            "*LABEL",
            "MOVJ C000 VJ=5.00",
            "MOVJ C001 PL=2",
        ],
    )
    found = read_text(tmp_path, "a.jbi", text)
    zero, per_unit = controller(hinged()).pulses.zero, controller(hinged()).pulses.per_unit
    there = zero + np.array([85000, -73000, 0, 0, 0, 0]) / per_unit
    assert np.abs(found.x - [there, zero, there]).max() < 1e-15
    assert any("DOUT, SPEED" in note for note in found.notes) and any("sharp" in note for note in found.notes)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("MOVL C00000 V=10.0", "line 14: MOVL moves in a way that cannot be read; only MOVJ can be read"),
        ("MOVC C00000 V=10.0", "line 14: MOVC moves in a way"),
        ("SMOVL C00000 V=10.0", "line 14: SMOVL moves in a way"),
        ("IMOV P000 V=10.0", "line 14: IMOV moves in a way"),
        ("MOVJ C00000 VJ=5.00 +MOVL EC00000 V=5.0", "line 14: +MOVL moves in a way"),
        ("MOVJ C00000 VJ=5.00 UNTIL IN#(1)=ON", "line 14: UNTIL ends a move early"),
        ("MOVJ P000 VJ=5.00", "line 14: position P belongs to the controller"),
        ("MOVJ C00009 VJ=5.00", "line 14: position C00009 is not in the job"),
        ("MOVJ C00000 EC00000 VJ=5.00", "line 14: it moves C EC; program.groups needs C"),
        ("JUMP *LABEL", "line 14: JUMP controls the flow"),
        ("CALL JOB:OTHER", "line 14: CALL controls the flow"),
        ("GRASP 1", "line 14: GRASP is not known"),
        ("MOVJ VJ=5.00 C00000", "line 14: 'MOVJ VJ=5.00 C00000' cannot be read"),
        ("MOVJ C00000 VJ=5.00 VJ=6.00", "line 14: 'MOVJ C00000 VJ=5.00 VJ=6.00' cannot be read"),
        ("MOVJ C00000 FAST", "line 14: 'MOVJ C00000 FAST' cannot be read"),
    ],
)
def test_what_cannot_be_read_of_a_job_is_refused_with_its_line(line, message, tmp_path):
    text = job(["C00000=0,0,0,0,0,0"], [line])
    assert refusal(tmp_path, "a.jbi", text).startswith(f"a.jbi, {message}")


@pytest.mark.parametrize(
    ("position", "message"),
    [
        ("C00000=0,0,0,0,0", "line 9: 5 values for 6 joints"),
        ("C00000=0,0,0,0,0,0,7", "line 9: 7 values for 6 joints"),
        ("C00000=0,0,0,0,0,x", "line 9: position C00000 holds a value that is not a number"),
        ("C00000=0,0,0,0,0,nan", "line 9: position C00000 holds a value that is not a number"),
        ("C00000=0,0,0,0,0,0\r\nC00000=0,0,0,0,0,0", "line 10: position C00000 is given twice"),
        ("hello", "line 9: 'hello' is not a position"),
        ("///SPEED 3", "line 9: ///SPEED 3 is not known among positions"),
        ("///RECTAN", "line 9: ///RECTAN after ///POSTYPE PULSE"),
    ],
)
def test_a_position_that_is_damaged_is_refused_with_its_line(position, message, tmp_path):
    text = job([position], ["MOVJ C00000 VJ=1.00"], counts=[1, 0, 0, 0, 0, 0])
    assert refusal(tmp_path, "a.jbi", text).startswith(f"a.jbi, {message}")


def test_a_job_needs_its_pulses_groups_and_the_number_of_positions_that_it_states(tmp_path):
    one = job(["C00000=0,0,0,0,0,0"], ["MOVJ C00000 VJ=1.00"])
    assert "set program.pulses" in refusal(tmp_path, "a.jbi", one, given=controller(hinged(), pulses=None))
    assert "program.groups needs C BC EC" in refusal(tmp_path, "b.jbi", one, railed())
    assert GROUPS.external == (0, 7)
    wrong = job(["C00000=0,0,0,0,0,0"], ["MOVJ C00000 VJ=1.00"], counts=[2, 0, 0, 0, 0, 0])
    assert refusal(tmp_path, "c.jbi", wrong) == "c.jbi: ///NPOS 2,0,0,0,0,0, but the job has 1,0,0,0,0,0 positions"


def test_a_job_of_poses_has_poses_and_no_configurations(tmp_path):
    kind = "///POSTYPE USER", "///RECTAN", "///RCONF 1,0,0,0,0,0,0,0"
    positions = ["C00000=500.5,-20,300,10,-20,30", "C00001=0,0,0,180,0,0"]
    found = read_text(tmp_path, "a.jbi", job(positions, ["MOVJ C00000 VJ=1.00", "MOVL C00001 V=10.0"], kind))
    assert (found.format, found.x.shape, found.poses.shape, found.line.tolist()) == ("jbi", (0, 6), (2, 4, 4), [16, 17])
    assert np.allclose(found.poses[0][:3, 3], [0.5005, -0.02, 0.3], atol=1e-15)
    assert np.allclose(found.poses[0][:3, :3], Rotation.from_euler("xyz", [10, -20, 30], degrees=True).as_matrix())
    assert any("USER 1, tool 2" in note for note in found.notes)


def test_a_job_with_poses_and_pulses_is_refused(tmp_path):
    positions = ["C00000=0,0,0,0,0,0", "///POSTYPE USER", "///RECTAN", "C00001=0,0,0,0,0,0"]
    message = refusal(tmp_path, "a.jbi", job(positions, ["MOVJ C00000 VJ=1.00", "MOVJ C00001 VJ=1.00"]))
    assert message.startswith("a.jbi, line 12: a pose; only pulses have a configuration")


# --- units


@pytest.mark.parametrize(
    ("name", "text", "unit", "message"),
    [
        ("a.mod", MODULE, "rad", "RAPID holds deg; --unit rad contradicts that"),
        ("a.script", SCRIPT, "deg", "URScript holds rad; --unit deg contradicts that"),
        ("a.jbi", job(["C00000=0,0,0,0,0,0"], ["MOVJ C00000 VJ=1.00"]), "deg", "a job with pulses holds pulses"),
    ],
)
def test_another_unit_than_the_languages_is_refused(name, text, unit, message, tmp_path):
    assert message in refusal(tmp_path, name, text, unit=unit)


def test_a_script_in_degrees_gets_a_note_with_its_line_and_one_in_radians_none(tmp_path):
    text = "def program():\n  movej([0,-1.57,0,0,0,0])\n  movej([{},-1.57,0,0,0,0])\nend\nprogram()\n"
    degrees, radians = (read_text(tmp_path, "p.script", text.format(value)) for value in (45, 0.7853981634))
    assert any("is 45 rad on line 3, more than a turn" in note for note in degrees.notes)
    assert not any("turn" in note for note in radians.notes)
