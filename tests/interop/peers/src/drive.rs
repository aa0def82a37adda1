//! Drives a robot for some simulation time, and measures the way by its odometry.

use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::prelude::*;
use serde_json::json;

use crate::interfaces::builtin_interfaces::Time;
use crate::interfaces::geometry_msgs::{Twist, TwistStamped};
use crate::interfaces::nav_msgs::Odometry;
use crate::peer::{Network, print, reliable};

/// Commands hold for half a second.
const SEND_EVERY: Duration = Duration::from_millis(50);
const MATCH_WITHIN: Duration = Duration::from_secs(20);
/// Simulation time in which the robot comes to rest [s].
const STOP_S: f64 = 1.0;

#[derive(clap::Args)]
pub struct Drive {
    /// Namespace of the robot, with the leading slash.
    #[arg(long)]
    robot: String,
    /// Send TwistStamped instead of Twist.
    #[arg(long)]
    stamped: bool,
    /// Forward velocity [m/s].
    #[arg(long, default_value_t = 0.2)]
    speed: f64,
    /// Simulation time [s].
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// Wall time after which the program gives up [s].
    #[arg(long, default_value_t = 60.0)]
    within: f64,
}

impl Drive {
    pub async fn run(self, network: &Network) -> Result<()> {
        let (_context, node) = network.join("interop_drive")?;
        let odom = node
            .create_sub::<Odometry>(&format!("{}/odom", self.robot))
            .with_qos(reliable(1))
            .build()?;
        let commands = Commands::new(&node, &format!("{}/cmd_vel", self.robot), self.stamped)?;
        let matched = commands.wait().await;
        let give_up = Instant::now() + Duration::from_secs_f64(self.within);
        let mut newest = odom.recv_timeout(MATCH_WITHIN)?;
        let begin = Place::of(&newest);
        let mut sent = 0;
        for (speed, until_s) in [(self.speed, self.seconds), (0.0, self.seconds + STOP_S)] {
            while Place::of(&newest).time_s < begin.time_s + until_s && Instant::now() < give_up {
                commands.send(speed, &newest)?;
                sent += 1;
                tokio::time::sleep(SEND_EVERY).await;
                newest = odom.recv_timeout(MATCH_WITHIN)?;
            }
        }
        let end = Place::of(&newest);
        print(&json!({
            "matched": matched,
            "sent": sent,
            "moved_m": (end.x - begin.x).hypot(end.y - begin.y),
            "sim_s": end.time_s - begin.time_s,
        }));
        Ok(())
    }
}

struct Place {
    x: f64,
    y: f64,
    time_s: f64,
}

impl Place {
    fn of(odom: &Odometry) -> Self {
        let (point, stamp) = (&odom.pose.pose.position, &odom.header.stamp);
        let time_s = f64::from(stamp.sec) + f64::from(stamp.nanosec) * 1e-9;
        Self {
            x: point.x,
            y: point.y,
            time_s,
        }
    }
}

type Publisher<T> = ZPub<T, <T as hiroz::msg::ZMessage>::Serdes>;

enum Commands {
    Plain(Publisher<Twist>),
    Stamped(Publisher<TwistStamped>),
}

impl Commands {
    fn new(node: &ZNode, topic: &str, stamped: bool) -> Result<Self> {
        Ok(if stamped {
            Self::Stamped(node.create_pub::<TwistStamped>(topic).build()?)
        } else {
            Self::Plain(node.create_pub::<Twist>(topic).build()?)
        })
    }

    async fn wait(&self) -> bool {
        match self {
            Self::Plain(publisher) => publisher.wait_for_subscription(1, MATCH_WITHIN).await,
            Self::Stamped(publisher) => publisher.wait_for_subscription(1, MATCH_WITHIN).await,
        }
    }

    fn send(&self, speed: f64, odom: &Odometry) -> Result<()> {
        let mut twist = Twist::default();
        twist.linear.x = speed;
        match self {
            Self::Plain(publisher) => publisher.publish(&twist),
            Self::Stamped(publisher) => {
                let mut stamped = TwistStamped {
                    twist,
                    ..Default::default()
                };
                let stamp = &odom.header.stamp;
                stamped.header.stamp = Time {
                    sec: stamp.sec,
                    nanosec: stamp.nanosec,
                };
                publisher.publish(&stamped)
            }
        }
    }
}
