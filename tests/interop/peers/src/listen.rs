//! Topics that publish often: what a ROS 2 subscriber receives, and what a plain one does.
//!
//! hiroz subscribes as rmw_zenoh does, with an advanced subscriber that drops samples whose
//! timestamp is not newer than the last one of the same clock. The plain one drops nothing.

use std::any::Any;
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::attachment::{Attachment, GidArray};
use hiroz::msg::{ZDeserializer, ZMessage};
use hiroz::prelude::*;
use hiroz::queue::BoundedQueue;
use serde_json::{Value, json};
use zenoh::Wait;
use zenoh::sample::Sample;

use crate::interfaces::{nav_msgs::Odometry, sensor_msgs::JointState, tf2_msgs::TFMessage};
use crate::peer::{Network, POLL, print, reliable};

/// More than arrive between two polls.
const DEPTH: usize = 100_000;
/// Time for the last samples.
const SETTLE: Duration = Duration::from_millis(500);

#[derive(clap::Args)]
pub struct Listen {
    /// Topics of type nav_msgs/msg/Odometry.
    #[arg(long)]
    odom: Vec<String>,
    /// Topics of type tf2_msgs/msg/TFMessage.
    #[arg(long)]
    tf: Vec<String>,
    /// Topics of type sensor_msgs/msg/JointState.
    #[arg(long)]
    joints: Vec<String>,
    #[arg(long)]
    seconds: f64,
}

impl Listen {
    pub fn run(self, network: &Network) -> Result<()> {
        let (_context, node) = network.join("interop_listen")?;
        let mut topics = Vec::new();
        for name in &self.odom {
            topics.push(Topic::subscribe::<Odometry>(&node, name)?);
        }
        for name in &self.tf {
            topics.push(Topic::subscribe::<TFMessage>(&node, name)?);
        }
        for name in &self.joints {
            topics.push(Topic::subscribe::<JointState>(&node, name)?);
        }
        let end = Instant::now() + Duration::from_secs_f64(self.seconds);
        while Instant::now() < end {
            topics.iter_mut().for_each(Topic::drain);
            std::thread::sleep(POLL);
        }
        for topic in &mut topics {
            topic.stop_counting()?;
        }
        std::thread::sleep(SETTLE);
        topics.iter_mut().for_each(Topic::drain);
        let found: HashMap<_, _> = topics
            .iter()
            .map(|one| (&one.name, one.summary()))
            .collect();
        print(&json!({ "topics": found }));
        Ok(())
    }
}

/// Sequence numbers by publisher.
#[derive(Default)]
struct Received {
    numbers: HashMap<GidArray, BTreeSet<i64>>,
    total: usize,
    without_attachment: usize,
}

impl Received {
    fn add(&mut self, sample: &Sample) {
        self.total += 1;
        match sample.attachment().map(Attachment::try_from) {
            Some(Ok(found)) => {
                self.numbers
                    .entry(found.source_gid)
                    .or_default()
                    .insert(found.sequence_number);
            }
            _ => self.without_attachment += 1,
        }
    }

    /// Numbers that are missing between the first and the last of each publisher.
    fn gaps(&self) -> i64 {
        let span = |one: &BTreeSet<i64>| one.last().unwrap_or(&0) - one.first().unwrap_or(&1) + 1;
        self.numbers
            .values()
            .map(|one| span(one) - one.len() as i64)
            .sum()
    }

    /// Samples of this one that the other has not.
    fn missing_in(&self, other: &Received) -> usize {
        let absent = |gid: &GidArray, number: &i64| {
            !other
                .numbers
                .get(gid)
                .is_some_and(|one| one.contains(number))
        };
        self.numbers
            .iter()
            .map(|(gid, all)| all.iter().filter(|n| absent(gid, n)).count())
            .sum()
    }
}

struct Topic {
    name: String,
    queue: Arc<BoundedQueue<Sample>>,
    decodes: fn(&[u8]) -> bool,
    advanced: Received,
    undecodable: usize,
    plain: Arc<Mutex<Received>>,
    plain_subscriber: Option<zenoh::pubsub::Subscriber<()>>,
    _subscriber: Box<dyn Any>,
}

impl Topic {
    fn subscribe<T>(node: &ZNode, name: &str) -> Result<Self>
    where
        T: ZMessage + WithTypeInfo,
        T::Serdes: 'static,
        for<'a> T::Serdes: ZDeserializer<Output = T, Input<'a> = &'a [u8]>,
    {
        let subscriber = node
            .create_sub::<T>(name)
            .with_qos(reliable(DEPTH))
            .build()?;
        let key = node.keyexpr_format().topic_key_expr(&subscriber.entity)?;
        let plain = Arc::new(Mutex::new(Received::default()));
        let counted = plain.clone();
        let plain_subscriber = node
            .session()
            .declare_subscriber((*key).clone())
            .callback(move |sample| counted.lock().expect("no panic").add(&sample))
            .wait()?;
        Ok(Self {
            name: name.to_string(),
            queue: subscriber.queue.clone().expect("built with a queue"),
            decodes: |payload| T::deserialize(payload).is_ok(),
            advanced: Received::default(),
            undecodable: 0,
            plain,
            plain_subscriber: Some(plain_subscriber),
            _subscriber: Box::new(subscriber),
        })
    }

    fn drain(&mut self) {
        while let Some(sample) = self.queue.try_recv() {
            self.advanced.add(&sample);
            self.undecodable += usize::from(!(self.decodes)(&sample.payload().to_bytes()));
        }
    }

    /// Undeclare the plain subscriber: the other one must have received what this has.
    fn stop_counting(&mut self) -> Result<()> {
        self.plain_subscriber
            .take()
            .map_or(Ok(()), |one| one.undeclare().wait())
    }

    fn summary(&self) -> Value {
        let plain = self.plain.lock().expect("no panic");
        json!({
            "plain": plain.total,
            "advanced": self.advanced.total,
            "missing": plain.missing_in(&self.advanced),
            "gaps": plain.gaps(),
            "publishers": plain.numbers.len(),
            "without_attachment": plain.without_attachment,
            "undecodable": self.undecodable,
        })
    }
}
