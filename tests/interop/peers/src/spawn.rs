//! Clients that spawn and delete entities at the same time, and what bad requests get.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::attachment::Attachment;
use hiroz::msg::{ZDeserializer, ZMessage, ZService};
use hiroz::prelude::*;
use serde_json::{Value, json};
use zenoh::query::{ConsolidationMode, QueryTarget};

use crate::interfaces::simulation_interfaces::srv::{DeleteEntity, SpawnEntity};
use crate::interfaces::simulation_interfaces::{
    DeleteEntityRequest, Resource, SpawnEntityRequest, SpawnEntityResponse,
};
use crate::interfaces::v1::ros::simulation_interfaces as v1;
use crate::peer::{Network, ms_since, print};

const CALL_WITHIN: Duration = Duration::from_secs(30);
const OK: u8 = 1;
/// Distance between robots, and in a row.
const SPACING_M: f64 = 3.0;
const ROW: usize = 20;
/// CDR of no request: a string of four gigabytes.
const MALFORMED: [u8; 8] = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff];

#[derive(clap::Args, Clone)]
pub struct Spawn {
    #[arg(long, default_value_t = 4)]
    clients: usize,
    /// Calls of all clients together.
    #[arg(long, default_value_t = 200)]
    calls: usize,
    /// Use simulation_interfaces 1.x.
    #[arg(long)]
    v1: bool,
    #[arg(long, default_value = "box_bot")]
    uri: String,
    #[arg(long, default_value = "foreign")]
    prefix: String,
}

impl Spawn {
    pub async fn run(self, network: &Network, extra_replies: Arc<AtomicUsize>) -> Result<()> {
        let mut clients = Vec::new();
        for number in 0..self.clients {
            clients.push(tokio::spawn(self.clone().call_all(network.clone(), number)));
        }
        let (mut spawned, mut refused, mut failed) = (Vec::new(), Vec::new(), Vec::new());
        for client in clients {
            for call in client.await?? {
                match call {
                    Called::Spawned(ms) => spawned.push(ms),
                    Called::Refused(text) => refused.push(text),
                    Called::Failed(text) => failed.push(text),
                }
            }
        }
        let bad = if self.v1 {
            self.send_bad::<v1::srv::SpawnEntity>(network).await?
        } else {
            self.send_bad::<SpawnEntity>(network).await?
        };
        print(&json!({
            "spawned_ms": spawned,
            "refused": refused,
            "failed": failed,
            "extra_replies": extra_replies.load(Ordering::Relaxed),
            "bad": bad,
        }));
        Ok(())
    }

    async fn call_all(self, network: Network, number: usize) -> Result<Vec<Called>> {
        let (_context, node) = network.join(&format!("interop_spawn_{number}"))?;
        let newest = node.create_client::<SpawnEntity>("/spawn_entity").build()?;
        let old = node
            .create_client::<v1::srv::SpawnEntity>("/spawn_entity")
            .build()?;
        let delete = node
            .create_client::<DeleteEntity>("/delete_entity")
            .build()?;
        let mut calls = Vec::new();
        for call in (number..self.calls).step_by(self.clients) {
            let name = format!("{}_{call}", self.prefix);
            let begin = Instant::now();
            let response = if self.v1 {
                let request = self.write_v1(&name, call);
                let response = old.call_with_timeout(&request, CALL_WITHIN).await;
                response.map(|one| (one.result.result, one.result.error_message, one.entity_name))
            } else {
                let request = self.write_newest(&name, call);
                let response = newest.call_with_timeout(&request, CALL_WITHIN).await;
                response.map(|one| (one.result.result, one.result.error_message, one.entity_name))
            };
            let ms = ms_since(begin);
            calls.push(match response {
                Ok((OK, _, entity)) if entity == name => Called::Spawned(ms),
                Ok((code, text, entity)) => Called::Refused(format!("{entity} {code} {text}")),
                Err(error) => Called::Failed(error.to_string()),
            });
            let request = DeleteEntityRequest { entity: name };
            delete.call_with_timeout(&request, CALL_WITHIN).await?;
        }
        Ok(calls)
    }

    fn write_newest(&self, name: &str, number: usize) -> SpawnEntityRequest {
        let mut request = SpawnEntityRequest {
            name: name.to_string(),
            entity_resource: Resource {
                uri: self.uri.clone(),
                ..Default::default()
            },
            ..Default::default()
        };
        let position = &mut request.initial_pose.pose.position;
        (position.x, position.y) = place(number);
        request.initial_pose.pose.orientation.w = 1.0;
        request
    }

    fn write_v1(&self, name: &str, number: usize) -> v1::SpawnEntityRequest {
        let mut request = v1::SpawnEntityRequest {
            name: name.to_string(),
            uri: self.uri.clone(),
            ..Default::default()
        };
        let position = &mut request.initial_pose.pose.position;
        (position.x, position.y) = place(number);
        request.initial_pose.pose.orientation.w = 1.0;
        request
    }

    /// Send an unknown URI and malformed bytes; count the replies of each, and read the first.
    async fn send_bad<S>(&self, network: &Network) -> Result<Value>
    where
        S: ZService + ServiceTypeInfo,
    {
        let (_context, node) = network.join("interop_spawn_bad")?;
        let builder = node.create_client::<S>("/spawn_entity");
        let key = (*node.keyexpr_format().topic_key_expr(builder.entity())?).clone();
        let _client = builder.build()?;
        let unknown = Self {
            uri: "no_such_robot".to_string(),
            ..self.clone()
        };
        let refused = if self.v1 {
            unknown.write_v1("bad", 0).serialize()
        } else {
            unknown.write_newest("bad", 0).serialize()
        };
        let mut found = Vec::new();
        for payload in [refused, MALFORMED.to_vec()] {
            found.push(count_replies(&node, &key, payload).await?);
        }
        Ok(Value::Array(found))
    }
}

enum Called {
    Spawned(f64),
    Refused(String),
    Failed(String),
}

fn place(number: usize) -> (f64, f64) {
    (
        SPACING_M * (number % ROW) as f64,
        SPACING_M * (number / ROW) as f64,
    )
}

async fn count_replies(
    node: &ZNode,
    key: &zenoh::key_expr::KeyExpr<'static>,
    payload: Vec<u8>,
) -> Result<Value> {
    let (gid, number) = ([7; 16], 41);
    let begin = Instant::now();
    let replies = node
        .session()
        .get(key)
        .payload(payload)
        .attachment(Attachment::new(number, gid))
        .target(QueryTarget::AllComplete)
        .consolidation(ConsolidationMode::None)
        .timeout(CALL_WITHIN)
        .await?;
    let (mut count, mut first_ms, mut code, mut is_ours) = (0, 0.0, 0, false);
    while let Ok(reply) = replies.recv_async().await {
        count += 1;
        let Ok(sample) = reply.into_result() else {
            continue;
        };
        first_ms = ms_since(begin);
        let payload = sample.payload().to_bytes();
        code = decode_code(&payload);
        let attachment = sample.attachment().map(Attachment::try_from);
        is_ours = attachment.is_some_and(|one| {
            one.is_ok_and(|one| one.sequence_number == number && one.source_gid == gid)
        });
    }
    Ok(json!({ "replies": count, "ms": first_ms, "code": code, "attachment": is_ours }))
}

fn decode_code(payload: &[u8]) -> u8 {
    type Serdes = <SpawnEntityResponse as ZMessage>::Serdes;
    Serdes::deserialize(payload).map_or(0, |response| response.result.result)
}
