"""The part of PyBullet 3.2.7 that the engine calls; SI units, quaternions x y z w."""

from collections.abc import Sequence

_Vector = Sequence[float]
_Triple = tuple[float, float, float]
_Quadruple = tuple[float, float, float, float]
# position, velocity, reaction forces and torques, applied motor torque
_JointState = tuple[float, float, tuple[float, float, float, float, float, float], float]
# index, name, type, q index, u index, flags, damping, friction, lower, upper, max force,
# max velocity, link name, axis, parent frame position, parent frame orientation, parent index
_JointInfo = tuple[
    int,
    bytes,
    int,
    int,
    int,
    int,
    float,
    float,
    float,
    float,
    float,
    float,
    bytes,
    _Triple,
    _Triple,
    _Quadruple,
    int,
]
# mass, lateral friction, inertia diagonal, inertial position, inertial orientation, restitution,
# rolling friction, spinning friction, contact damping, contact stiffness, body type, margin
_DynamicsInfo = tuple[
    float, float, _Triple, _Triple, _Quadruple, float, float, float, float, float, int, float
]
# flag, body a, body b, link a, link b, position on a, position on b, normal on b, distance,
# normal force, lateral friction 1, its direction, lateral friction 2, its direction
_ContactPoint = tuple[
    int,
    int,
    int,
    int,
    int,
    _Triple,
    _Triple,
    _Triple,
    float,
    float,
    float,
    _Triple,
    float,
    _Triple,
]

DIRECT: int

WORLD_FRAME: int
LINK_FRAME: int

GEOM_SPHERE: int
GEOM_BOX: int
GEOM_CYLINDER: int
GEOM_MESH: int
GEOM_PLANE: int
GEOM_CAPSULE: int
GEOM_FORCE_CONCAVE_TRIMESH: int

JOINT_REVOLUTE: int
JOINT_PRISMATIC: int
JOINT_SPHERICAL: int
JOINT_PLANAR: int
JOINT_FIXED: int
JOINT_GEAR: int

VELOCITY_CONTROL: int
POSITION_CONTROL: int
TORQUE_CONTROL: int

ACTIVATION_STATE_ENABLE_SLEEPING: int
ACTIVATION_STATE_DISABLE_SLEEPING: int
ACTIVATION_STATE_WAKE_UP: int
ACTIVATION_STATE_SLEEP: int
ACTIVATION_STATE_ENABLE_WAKEUP: int
ACTIVATION_STATE_DISABLE_WAKEUP: int

URDF_USE_SELF_COLLISION: int
URDF_ENABLE_SLEEPING: int

# centre of mass, principal axes, their place in the link, link frame, velocities of the centre
_LinkState = tuple[_Triple, _Quadruple, _Triple, _Quadruple, _Triple, _Quadruple, _Triple, _Triple]

class error(Exception): ...

def connect(method: int, key: int = ..., options: str = ...) -> int: ...
def disconnect(physicsClientId: int = ...) -> None: ...
def isConnected(physicsClientId: int = ...) -> int: ...
def resetSimulation(flags: int = ..., physicsClientId: int = ...) -> None: ...
def stepSimulation(physicsClientId: int = ...) -> None: ...
def performCollisionDetection(physicsClientId: int = ...) -> None: ...
def getNumBodies(physicsClientId: int = ...) -> int: ...
def setGravity(gravX: float, gravY: float, gravZ: float, physicsClientId: int = ...) -> None: ...
def setTimeStep(timeStep: float, physicsClientId: int = ...) -> None: ...
def setPhysicsEngineParameter(
    *,
    fixedTimeStep: float = ...,
    numSolverIterations: int = ...,
    numSubSteps: int = ...,
    contactBreakingThreshold: float = ...,
    enableFileCaching: int = ...,
    restitutionVelocityThreshold: float = ...,
    erp: float = ...,
    contactERP: float = ...,
    frictionERP: float = ...,
    enableConeFriction: int = ...,
    deterministicOverlappingPairs: int = ...,
    jointFeedbackMode: int = ...,
    solverResidualThreshold: float = ...,
    minimumSolverIslandSize: int = ...,
    contactSlop: float = ...,
    globalCFM: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def createCollisionShape(
    shapeType: int,
    *,
    radius: float = ...,
    halfExtents: _Vector = ...,
    height: float = ...,
    fileName: str = ...,
    meshScale: _Vector = ...,
    planeNormal: _Vector = ...,
    flags: int = ...,
    collisionFramePosition: _Vector = ...,
    collisionFrameOrientation: _Vector = ...,
    vertices: Sequence[_Vector] = ...,
    indices: Sequence[int] = ...,
    physicsClientId: int = ...,
) -> int: ...
def createCollisionShapeArray(
    shapeTypes: Sequence[int],
    *,
    radii: Sequence[float] = ...,
    halfExtents: Sequence[_Vector] = ...,
    lengths: Sequence[float] = ...,
    fileNames: Sequence[str] = ...,
    meshScales: Sequence[_Vector] = ...,
    planeNormals: Sequence[_Vector] = ...,
    flags: Sequence[int] = ...,
    collisionFramePositions: Sequence[_Vector] = ...,
    collisionFrameOrientations: Sequence[_Vector] = ...,
    physicsClientId: int = ...,
) -> int: ...
def createVisualShape(
    shapeType: int,
    *,
    radius: float = ...,
    halfExtents: _Vector = ...,
    length: float = ...,
    fileName: str = ...,
    meshScale: _Vector = ...,
    rgbaColor: _Vector = ...,
    visualFramePosition: _Vector = ...,
    visualFrameOrientation: _Vector = ...,
    physicsClientId: int = ...,
) -> int: ...
def createMultiBody(
    baseMass: float = ...,
    baseCollisionShapeIndex: int = ...,
    baseVisualShapeIndex: int = ...,
    basePosition: _Vector = ...,
    baseOrientation: _Vector = ...,
    *,
    baseInertialFramePosition: _Vector = ...,
    baseInertialFrameOrientation: _Vector = ...,
    linkMasses: Sequence[float] = ...,
    linkCollisionShapeIndices: Sequence[int] = ...,
    linkVisualShapeIndices: Sequence[int] = ...,
    linkPositions: Sequence[_Vector] = ...,
    linkOrientations: Sequence[_Vector] = ...,
    linkInertialFramePositions: Sequence[_Vector] = ...,
    linkInertialFrameOrientations: Sequence[_Vector] = ...,
    linkParentIndices: Sequence[int] = ...,
    linkJointTypes: Sequence[int] = ...,
    linkJointAxis: Sequence[_Vector] = ...,
    useMaximalCoordinates: int = ...,
    flags: int = ...,
    physicsClientId: int = ...,
) -> int: ...
def calculateMassMatrix(
    bodyUniqueId: int, objPositions: Sequence[float], physicsClientId: int = ...
) -> tuple[tuple[float, ...], ...]: ...
def calculateInverseDynamics(
    bodyUniqueId: int,
    objPositions: Sequence[float],
    objVelocities: Sequence[float],
    objAccelerations: Sequence[float],
    *,
    physicsClientId: int = ...,
) -> tuple[float, ...]: ...
def createConstraint(
    parentBodyUniqueId: int,
    parentLinkIndex: int,
    childBodyUniqueId: int,
    childLinkIndex: int,
    jointType: int,
    jointAxis: Sequence[float],
    parentFramePosition: Sequence[float],
    childFramePosition: Sequence[float],
    physicsClientId: int = ...,
) -> int: ...
def changeConstraint(
    userConstraintUniqueId: int,
    *,
    gearRatio: float = ...,
    relativePositionTarget: float = ...,
    erp: float = ...,
    maxForce: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def removeConstraint(userConstraintUniqueId: int, physicsClientId: int = ...) -> None: ...
def saveBullet(bulletFileName: str, physicsClientId: int = ...) -> None: ...
def restoreState(fileName: str, physicsClientId: int = ...) -> None: ...
def removeBody(bodyUniqueId: int, physicsClientId: int = ...) -> None: ...
def removeCollisionShape(collisionShapeId: int, physicsClientId: int = ...) -> None: ...
def changeDynamics(
    bodyUniqueId: int,
    linkIndex: int,
    *,
    mass: float = ...,
    lateralFriction: float = ...,
    spinningFriction: float = ...,
    rollingFriction: float = ...,
    restitution: float = ...,
    linearDamping: float = ...,
    angularDamping: float = ...,
    contactStiffness: float = ...,
    contactDamping: float = ...,
    frictionAnchor: int = ...,
    localInertiaDiagonal: _Vector = ...,
    contactProcessingThreshold: float = ...,
    activationState: int = ...,
    jointDamping: float = ...,
    anisotropicFriction: _Vector = ...,
    maxJointVelocity: float = ...,
    collisionMargin: float = ...,
    jointLowerLimit: float = ...,
    jointUpperLimit: float = ...,
    jointLimitForce: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def getDynamicsInfo(
    bodyUniqueId: int, linkIndex: int, flags: int = ..., physicsClientId: int = ...
) -> _DynamicsInfo: ...
def resetBasePositionAndOrientation(
    bodyUniqueId: int, posObj: _Vector, ornObj: _Vector, physicsClientId: int = ...
) -> None: ...
def resetBaseVelocity(
    objectUniqueId: int,
    linearVelocity: _Vector = ...,
    angularVelocity: _Vector = ...,
    physicsClientId: int = ...,
) -> None: ...
def resetJointState(
    bodyUniqueId: int,
    jointIndex: int,
    targetValue: float,
    targetVelocity: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def getBasePositionAndOrientation(
    bodyUniqueId: int, physicsClientId: int = ...
) -> tuple[_Triple, _Quadruple]: ...
def getBaseVelocity(bodyUniqueId: int, physicsClientId: int = ...) -> tuple[_Triple, _Triple]: ...
def getNumJoints(bodyUniqueId: int, physicsClientId: int = ...) -> int: ...
def getJointInfo(bodyUniqueId: int, jointIndex: int, physicsClientId: int = ...) -> _JointInfo: ...
def getJointStates(
    bodyUniqueId: int, jointIndices: Sequence[int], physicsClientId: int = ...
) -> tuple[_JointState, ...]: ...
def setJointMotorControl2(
    bodyUniqueId: int,
    jointIndex: int,
    controlMode: int,
    *,
    targetPosition: float = ...,
    targetVelocity: float = ...,
    force: float = ...,
    positionGain: float = ...,
    velocityGain: float = ...,
    maxVelocity: float = ...,
    physicsClientId: int = ...,
) -> None: ...
def setJointMotorControlArray(
    bodyUniqueId: int,
    jointIndices: Sequence[int],
    controlMode: int,
    *,
    targetPositions: Sequence[float] = ...,
    targetVelocities: Sequence[float] = ...,
    forces: Sequence[float] = ...,
    positionGains: Sequence[float] = ...,
    velocityGains: Sequence[float] = ...,
    physicsClientId: int = ...,
) -> None: ...
def setCollisionFilterPair(
    bodyUniqueIdA: int,
    bodyUniqueIdB: int,
    linkIndexA: int,
    linkIndexB: int,
    enableCollision: int,
    physicsClientId: int = ...,
) -> None: ...
def setCollisionFilterGroupMask(
    bodyUniqueId: int,
    linkIndexA: int,
    collisionFilterGroup: int,
    collisionFilterMask: int,
    physicsClientId: int = ...,
) -> None: ...
def getContactPoints(
    bodyA: int = ...,
    bodyB: int = ...,
    linkIndexA: int = ...,
    linkIndexB: int = ...,
    physicsClientId: int = ...,
) -> tuple[_ContactPoint, ...]: ...
def getOverlappingObjects(
    aabbMin: _Vector, aabbMax: _Vector, physicsClientId: int = ...
) -> tuple[tuple[int, int], ...] | None: ...
def getClosestPoints(
    bodyA: int, bodyB: int, distance: float, physicsClientId: int = ...
) -> tuple[_ContactPoint, ...]: ...
def getAABB(
    bodyUniqueId: int, linkIndex: int = ..., physicsClientId: int = ...
) -> tuple[_Triple, _Triple]: ...
def applyExternalForce(
    objectUniqueId: int,
    linkIndex: int,
    forceObj: _Vector,
    posObj: _Vector,
    flags: int,
    physicsClientId: int = ...,
) -> None: ...
def applyExternalTorque(
    objectUniqueId: int,
    linkIndex: int,
    torqueObj: _Vector,
    flags: int,
    physicsClientId: int = ...,
) -> None: ...
def getLinkState(
    bodyUniqueId: int,
    linkIndex: int,
    *,
    computeLinkVelocity: int = ...,
    computeForwardKinematics: int = ...,
    physicsClientId: int = ...,
) -> _LinkState: ...
def rayTestBatch(
    rayFromPositions: Sequence[_Vector],
    rayToPositions: Sequence[_Vector],
    physicsClientId: int = ...,
) -> tuple[tuple[int, int, float, _Triple, _Triple], ...]: ...
