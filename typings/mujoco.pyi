"""The part of MuJoCo 3.17 and 4.0 that engine and proof call; SI units, quaternions w x y z."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int32]

class mjtJoint:
    mjJNT_FREE: mjtJoint

class mjtSolver:
    mjSOL_CG: mjtSolver
    def __int__(self) -> int: ...

class mjtJacobian:
    mjJAC_DENSE: mjtJacobian
    mjJAC_SPARSE: mjtJacobian
    def __int__(self) -> int: ...

class _Option:
    solver: int
    jacobian: int
    enableflags: int
    iterations: int
    timestep: float

class MjModel:
    opt: _Option
    nv: int
    qpos0: _Floats
    body_pos: _Floats
    body_quat: _Floats
    body_inertia: _Floats
    body_invweight0: _Floats
    body_gravcomp: _Floats
    body_rootid: _Ints
    body_weldid: _Ints
    body_treeid: _Ints
    body_parentid: _Ints
    tree_sleep_policy: _Ints
    body_contype: _Ints
    body_conaffinity: _Ints
    geom_bodyid: _Ints
    geom_dataid: _Ints
    geom_priority: _Ints
    geom_friction: _Floats
    geom_contype: _Ints
    geom_conaffinity: _Ints
    geom_rbound: _Floats
    geom_solref: _Floats
    geom_solimp: _Floats
    jnt_qposadr: _Ints
    jnt_range: _Floats
    dof_M0: _Floats
    jnt_type: _Ints
    dof_jntid: _Ints
    dof_treeid: _Ints
    dof_bodyid: _Ints
    jnt_stiffness: _Floats
    dof_frictionloss: _Floats
    dof_damping: _Floats
    dof_invweight0: _Floats
    @staticmethod
    def from_xml_string(xml: str, assets: Mapping[str, bytes] = ...) -> MjModel: ...
    def __copy__(self) -> MjModel: ...

class _Contacts:
    dim: _Ints
    efc_address: _Ints
    geom: _Ints
    dist: _Floats
    frame: _Floats
    friction: _Floats
    pos: _Floats

class MjData:
    efc_force: _Floats
    ne: int
    nf: int
    nl: int
    nefc: int
    ncon: int
    qpos: _Floats
    qvel: _Floats
    qacc: _Floats
    qacc_warmstart: _Floats
    qfrc_actuator: _Floats
    qfrc_spring: _Floats
    qfrc_applied: _Floats
    xfrc_applied: _Floats
    eq_active: npt.NDArray[np.uint8]
    nbuffer: int
    dof_island: _Ints
    tree_asleep: _Ints
    tree_awake: _Ints
    body_awake: _Ints
    body_awake_ind: _Ints
    parent_awake_ind: _Ints
    dof_awake_ind: _Ints
    ntree_awake: int
    nbody_awake: int
    nparent_awake: int
    nv_awake: int
    efc_aref: _Floats
    efc_vel: _Floats
    efc_KBIP: _Floats
    efc_R: _Floats
    efc_D: _Floats
    iefc_R: _Floats
    iefc_D: _Floats
    map_efc2iefc: npt.NDArray[np.int32]
    nisland: int
    efc_pos: _Floats
    geom_xpos: _Floats
    xmat: _Floats
    cvel: _Floats
    xipos: _Floats
    ximat: _Floats
    subtree_com: _Floats
    contact: _Contacts
    def __init__(self, model: MjModel) -> None: ...

class mjtState:
    mjSTATE_INTEGRATION: int

def mj_copyData(d_dest: MjData, m: MjModel, d_src: MjData) -> None: ...
def mj_resetData(m: MjModel, d: MjData) -> None: ...
def mj_stateSize(m: MjModel, sig: int) -> int: ...
def mj_getState(m: MjModel, d: MjData, state: _Floats, sig: int) -> None: ...
def mj_setState(m: MjModel, d: MjData, state: _Floats, sig: int) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_step(m: MjModel, d: MjData) -> None: ...
def mj_step1(m: MjModel, d: MjData) -> None: ...
def mj_step2(m: MjModel, d: MjData) -> None: ...
def mj_makeConstraint(m: MjModel, d: MjData) -> None: ...
def mj_island(m: MjModel, d: MjData) -> None: ...
def mj_referenceConstraint(m: MjModel, d: MjData) -> None: ...
def mj_mulJacVec(m: MjModel, d: MjData, res: _Floats, vec: _Floats) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mj_setConst(m: MjModel, d: MjData) -> None: ...
def mj_geomDistance(
    m: MjModel, d: MjData, geom1: int, geom2: int, distmax: float, fromto: _Floats | None
) -> float: ...
def set_mju_user_warning(handler: Callable[[str], Any]) -> None: ...
