//! Two peers that talk with each other only: samples, a service, the graph.

use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::prelude::*;
use serde_json::json;

use crate::interfaces::std_msgs::String as Text;
use crate::interfaces::std_srvs::{TriggerRequest, TriggerResponse, srv::Trigger};
use crate::peer::{Network, POLL, print, reliable};

const TOPIC: &str = "/interop/chatter";
const SERVICE: &str = "/interop/trigger";
const TALKER: &str = "interop_talker";
const LISTENER: &str = "interop_listener";
const SEND_EVERY: Duration = Duration::from_millis(20);
const REPLY_WITHIN: Duration = Duration::from_secs(5);

#[derive(clap::Args)]
pub struct Talker {
    #[arg(long, default_value_t = 10)]
    count: usize,
    /// Time to discover the other one [s].
    #[arg(long, default_value_t = 10.0)]
    within: f64,
}

impl Talker {
    pub async fn run(self, network: &Network) -> Result<()> {
        let (context, node) = network.join(TALKER)?;
        let publisher = node
            .create_pub::<Text>(TOPIC)
            .with_qos(reliable(100))
            .build()?;
        let client = node.create_client::<Trigger>(SERVICE).build()?;
        let within = Duration::from_secs_f64(self.within);
        let is_matched = publisher.wait_for_subscription(1, within).await;
        for number in 0..self.count {
            publisher.publish(&Text {
                data: number.to_string(),
            })?;
            tokio::time::sleep(SEND_EVERY).await;
        }
        let request = TriggerRequest::default();
        let reply = client.call_with_timeout(&request, REPLY_WITHIN).await;
        print(&json!({
            "matched": is_matched,
            "replied": reply.is_ok_and(|response| response.success),
            "discovered": sees(&context, LISTENER),
        }));
        Ok(())
    }
}

#[derive(clap::Args)]
pub struct Listener {
    #[arg(long, default_value_t = 10)]
    count: usize,
    /// Time until the last sample and the request [s].
    #[arg(long, default_value_t = 30.0)]
    within: f64,
}

impl Listener {
    pub fn run(self, network: &Network) -> Result<()> {
        let (context, node) = network.join(LISTENER)?;
        let samples = node
            .create_sub::<Text>(TOPIC)
            .with_qos(reliable(100))
            .build()?;
        let mut server = node.create_service::<Trigger>(SERVICE).build()?;
        print(&json!({ "ready": true }));
        let (mut received, mut requests, mut discovered) = (Vec::new(), 0, false);
        let end = Instant::now() + Duration::from_secs_f64(self.within);
        while Instant::now() < end && (received.len() < self.count || requests == 0) {
            std::thread::sleep(POLL);
            while samples.is_ready() {
                received.push(samples.recv()?.data);
            }
            if let Some(request) = server.try_take_request()? {
                requests += 1;
                request.reply_blocking(&TriggerResponse {
                    success: true,
                    ..Default::default()
                })?;
            }
            discovered |= sees(&context, TALKER);
        }
        print(&json!({ "received": received, "requests": requests, "discovered": discovered }));
        // The reply is still on its way.
        std::thread::sleep(Duration::from_millis(500));
        Ok(())
    }
}

fn sees(context: &ZContext, name: &str) -> bool {
    context
        .graph()
        .get_node_names()
        .iter()
        .any(|(found, _)| found == name)
}
