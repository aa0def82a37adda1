//! Goals of the action simulate_steps.

use std::time::Duration;

use hiroz::Result;
use hiroz::action::client::ZActionClient;
use hiroz::action::messages::{CancelGoalServiceRequest, CancelService};
use hiroz::action::{GoalInfo, GoalStatus};
use hiroz::prelude::*;
use serde_json::{Value, json};

use crate::interfaces::simulation_interfaces::{SimulateStepsGoal, action::SimulateSteps};
use crate::peer::{Network, print};

const ACTION: &str = "/simulate_steps";
const CANCEL_TYPE: &str = "action_msgs::srv::dds_::CancelGoal_";
const SERVER_WITHIN: Duration = Duration::from_secs(20);
const RESULT_WITHIN: Duration = Duration::from_secs(60);
/// Steps of a goal that does not end by itself.
const ENDLESS: u64 = 5_000_000;

#[derive(clap::Args)]
pub struct Steps {
    #[arg(long, default_value_t = 240)]
    steps: u64,
    /// Send a long goal and cancel it.
    #[arg(long)]
    cancel: bool,
    /// Clients that send a goal at the same time.
    #[arg(long, default_value_t = 1)]
    clients: usize,
    /// Hash of action_msgs/srv/CancelGoal: hiroz 0.2.0 computes another one than ROS 2.
    #[arg(long, default_value = "TypeHashNotSupported")]
    cancel_hash: String,
}

impl Steps {
    pub async fn run(self, network: &Network) -> Result<()> {
        let (_context, node) = network.join("interop_steps")?;
        let mut clients = Vec::new();
        for _ in 0..self.clients {
            clients.push(node.create_action_client::<SimulateSteps>(ACTION).build()?);
        }
        let is_ready = clients[0].wait_for_server(SERVER_WITHIN).await;
        let goals = if self.cancel {
            vec![self.cancel_one(&node, &clients[0]).await?]
        } else {
            let mut running = Vec::new();
            for client in clients {
                running.push(tokio::spawn(run_one(client, self.steps)));
            }
            let mut ended = Vec::new();
            for one in running {
                ended.push(one.await??);
            }
            ended
        };
        print(&json!({ "server": is_ready, "goals": goals }));
        Ok(())
    }

    async fn cancel_one(
        &self,
        node: &ZNode,
        client: &ZActionClient<SimulateSteps>,
    ) -> Result<Value> {
        let hash = TypeHash::from_rihs_string(&self.cancel_hash).expect("a hash");
        let info = TypeInfo::new(CANCEL_TYPE, hash);
        let canceller = node
            .create_client_impl::<CancelService<SimulateSteps>>(
                &format!("{ACTION}/_action/cancel_goal"),
                Some(info),
            )
            .build()?;
        let mut goal = client
            .send_goal(SimulateStepsGoal { steps: ENDLESS })
            .await?;
        let mut status = goal.status_watch().expect("not taken before");
        let request = CancelGoalServiceRequest {
            goal_info: GoalInfo::new(goal.id()),
        };
        let response = canceller.call_with_timeout(&request, RESULT_WITHIN).await?;
        let has_ended = wait_for_end(&mut status).await;
        let result = goal.result_with_timeout(RESULT_WITHIN).await?;
        Ok(json!({
            "return_code": response.return_code,
            "canceling": response.goals_canceling.len(),
            "code": result.result.result,
            "status": format!("{:?}", *status.borrow()),
            "ended": has_ended,
        }))
    }
}

/// Wait for the last status: the library drops what comes after the result.
async fn wait_for_end(status: &mut tokio::sync::watch::Receiver<GoalStatus>) -> bool {
    let ended = status.wait_for(GoalStatus::is_terminal);
    tokio::time::timeout(RESULT_WITHIN, ended)
        .await
        .is_ok_and(|one| one.is_ok())
}

async fn run_one(client: ZActionClient<SimulateSteps>, steps: u64) -> Result<Value> {
    let sent = client.send_goal(SimulateStepsGoal { steps }).await;
    let mut goal = match sent {
        Ok(goal) => goal,
        Err(error) => return Ok(json!({ "accepted": false, "error": error.to_string() })),
    };
    let mut status = goal.status_watch().expect("not taken before");
    let mut feedback = goal.feedback().expect("not taken before");
    let has_ended = wait_for_end(&mut status).await;
    let result = goal.result_with_timeout(RESULT_WITHIN).await?;
    let mut completed = Vec::new();
    while let Ok(one) = feedback.try_recv() {
        completed.push(one.completed_steps);
    }
    Ok(json!({
        "accepted": true,
        "completed": completed,
        "code": result.result.result,
        "status": format!("{:?}", *status.borrow()),
        "ended": has_ended,
    }))
}
