"""What a drive comes to, in a line."""

from zensim.proto.messages.drive_messages import AckermannDrive, DiffDrive, Drive, TricycleDrive


def in_words(drive: Drive) -> str:
    """Say what matters of a drive."""
    match drive:
        case DiffDrive():
            pair = drive.pairs[0]
            return f"separation {pair.separation_m:g} m, diameter {pair.diameter_m:g} m"
        case AckermannDrive():
            return (
                f"wheelbase {drive.wheelbase_m:g} m, track {drive.track_m:g} m, "
                f"wheel radius {drive.wheel_radius_m:g} m"
            )
        case TricycleDrive():
            return f"actuated wheel {drive.actuated_wheel_diameter_m:g} m across"
        case _:
            return "the body takes the twist, sideways too"
